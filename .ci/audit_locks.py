"""Known vulnerabilities of the locked packages, by pip-audit: `make audit` runs this.

    python .ci/audit_locks.py envs/lock.txt ...

Exits with 1 if an advisory is known for a locked version, and with 2 if pip-audit cannot be run on a lock. Where its
database cannot be reached, or knows none of the packages (as mirrors of the registry do, which have no advisories), the
audit is skipped, aloud: no version is called sound that nobody has looked up.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

UNREACHABLE = re.compile(r"could not connect|connection|max retries|timed out|name resolution|temporar", re.IGNORECASE)
"""Words of pip-audit, and of what it calls, about a database that does not answer."""


@dataclass(frozen=True)
class Audit:
    """What came of one lock.

    Attributes:
        code: of this program: 0, 1 with advisories, 2 if it could not be run.
        lines: to print.
    """

    code: int
    lines: list[str]


def judge(lock: Path, report: dict | None, said: str) -> Audit:
    """Read pip-audit's report.

    Args:
        lock: that was looked at.
        report: in its JSON format; None if it wrote none.
        said: what it printed.
    """
    if report is None:
        last = (said.strip().splitlines() or ["nothing"])[-1]
        if UNREACHABLE.search(said):
            return Audit(0, [f"{lock}: audit skipped: the database of advisories cannot be reached: {last}"])
        return Audit(2, [f"{lock}: expected a report of pip-audit, found: {last}"])
    known = [package for package in report["dependencies"] if "skip_reason" not in package]
    left = len(report["dependencies"]) - len(known)
    if not known:
        return Audit(0, [f"{lock}: audit skipped: the database of advisories knows none of its {left} packages"])
    lines = [f"{lock}: {len(known)} packages looked up, {left} that the database does not know"]
    for package in known:
        for advisory in package["vulns"]:
            fixed = ", ".join(advisory["fix_versions"]) or "no version yet"
            lines.append(f"  {package['name']} {package['version']}: {advisory['id']}, mended in {fixed}")
    return Audit(int(len(lines) > 1), lines)


def audit(lock: Path) -> Audit:
    """Run pip-audit on a lock, without installing anything."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        command = [sys.executable, "-m", "pip_audit", "--requirement", str(lock), "--disable-pip", "--require-hashes"]
        command += ["--format", "json", "--output", str(report), "--progress-spinner", "off"]
        done = subprocess.run(command, capture_output=True, text=True)
        found = json.loads(report.read_text()) if report.is_file() and report.stat().st_size else None
        return judge(lock, found, done.stdout + done.stderr)


def main() -> None:
    """Command line."""
    audits = [audit(Path(word)) for word in sys.argv[1:]]
    print("\n".join(line for each in audits for line in each.lines))
    sys.exit(max((each.code for each in audits), default=0))


if __name__ == "__main__":
    main()
