"""Run attacks and print what came of them.

    python -m tests.chaos [--parts captures settings kills surroundings twice] [--seed 1] [--count N] [--minutes M]
        [--subject tiny] [--page docs/reliability.md]

Outcomes are added to attacks.csv as they come; a run that was ended goes on, and does nothing twice. A page beside it
has the table. Exits with 1 if an outcome is a defect.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
import time
from pathlib import Path

from tests.support.chaos import captures, forked_stage, kills, records, settings, sound_run, surroundings, twice
from tests.support.chaos.outcome import DEFECTS, Attack
from tests.support.chaos.sound_run import SUBJECT

ROOT = Path(__file__).resolve().parents[2]

PARTS = {
    "captures": (captures.attacks, 700),
    "settings": (settings.attacks, 600),
    "kills": (kills.attacks, 220),
    "surroundings": (surroundings.attacks, 250),
    "twice": (twice.attacks, 2),
}
"""Part -> what lists its attacks, and how many are drawn."""


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", nargs="*", choices=PARTS, default=list(PARTS), help="parts to run")
    parser.add_argument("--out", type=Path, default=Path("results/chaos"), help="folder for the tables")
    parser.add_argument("--seed", type=int, default=1, help="of all that is drawn")
    parser.add_argument("--count", type=int, help="attacks of each part, in place of its own number")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="after which no further attack begins")
    parser.add_argument("--subject", default=SUBJECT, help="whose runs the part twice compares")
    parser.add_argument("--page", type=Path, help="page of docs that the table is put into")
    parser.add_argument("--only", default="", help="attacks whose name has these letters")
    asked = parser.parse_args()
    started, out = time.monotonic(), asked.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    sound = sound_run.made(ROOT, out / "sound")
    forked_stage.prepare()
    table = out / "attacks.csv"
    done = {(record.part, record.attack) for record in records.read(table)}
    for part in asked.parts:
        attacks, count = PARTS[part]
        more = {"subject": asked.subject} if part == "twice" else {}
        for attack in attacks(sound, asked.seed, asked.count or count, **more):
            name = records.UNPRINTABLE.sub("?", attack.name)
            if (part, name) in done or asked.only not in name:
                continue
            if time.monotonic() - started > 60 * asked.minutes:
                break
            run_attack(part, attack, table, out)
    found = sorted(records.read(table), key=lambda record: list(PARTS).index(record.part))
    (out / "table.md").write_text(records.counted(found))
    print(records.counted(found))
    if asked.page:
        records.write_page(asked.page, found)
    sys.exit(bool(records.defects(found)))


def run_attack(part: str, attack: Attack, table: Path, out: Path) -> None:
    """Run one attack in a folder of its own and add its outcome to the table."""
    folder, began = Path(tempfile.mkdtemp(prefix="attack.", dir=out)), time.monotonic()
    try:
        result = attack.run(folder)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    record = records.append(table, part, attack.name, result, time.monotonic() - began)
    mark = "!" if record.outcome in DEFECTS else " "
    print(f"{mark} {part}: {record.attack}: {record.outcome}: {record.stage}: {record.said[:200]}", flush=True)


if __name__ == "__main__":
    main()
