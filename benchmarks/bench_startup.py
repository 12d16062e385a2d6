"""CPU seconds until something begins: a stage's help, a stage's imports, a plan of Snakemake.

    python -m benchmarks.bench_startup --finished results/subjectA --subjects 1 20

For every stage, `--help` and the import of its module, its start but for reading its arguments. For Snakemake, an empty
project with nothing to do (its own start), reading this project's Snakefile, and plans with nothing to do of so many
copies of a finished subject. User and system time of one process, the least of several rounds; each round runs
everything once, so that a busy machine slows all rows alike. With several roots, as `--root . ../before`, one column of
each. The row `import pandas` tells machines, and their load, apart.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import yaml

from pipeline import STAGES

PROJECT = ("Snakefile", "workflow", "profiles", "config", "envs", "pipeline")
"""What a project needs to be planned."""

EMPTY = 'rule nothing:\n    output: "made"\n    shell: "touch {output}"\n'

ENVIRONMENT = {"OMP_NUM_THREADS": "1", "OMP_WAIT_POLICY": "passive", "OPENBLAS_NUM_THREADS": "1"}

Command = tuple[Path, Sequence[str]]
"""A folder, and Python's arguments."""


def cpu_seconds(folder: Path, words: Sequence[str]) -> float:
    """CPU seconds of a Python process in a folder whose modules come first.

    Raises:
        SystemExit: if it fails.
    """
    child = os.fork()
    if not child:
        os.chdir(folder)
        silent = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silent, 1)
        os.dup2(silent, 2)
        os.execve(sys.executable, [sys.executable, *words], {**os.environ, **ENVIRONMENT, "PYTHONPATH": str(folder)})
    _, status, usage = os.wait4(child, 0)
    if os.waitstatus_to_exitcode(status):
        raise SystemExit(f"in {folder}: python {' '.join(words)}: exit code {os.waitstatus_to_exitcode(status)}")
    return usage.ru_utime + usage.ru_stime


def snakemake(*words: str) -> list[str]:
    """Python's arguments for Snakemake on two cores."""
    return ["-m", "snakemake", "--cores", "2", *words]


def project_of(root: Path, folder: Path, finished: Path | None, subjects: int) -> list[str]:
    """Copy a project with so many copies of a finished synthetic subject, all up to date.

    Returns:
        what is to be made of every subject.
    """
    folder.mkdir(parents=True)
    for name in PROJECT:
        if (root / name).is_dir():
            shutil.copytree(root / name, folder / name, ignore=shutil.ignore_patterns("subjects"))
        else:
            shutil.copy(root / name, folder)
    (folder / "config/subjects").mkdir(exist_ok=True)
    if finished is None:
        return []
    settings = yaml.safe_load((root / f"config/subjects/{finished.name}.yaml").read_text())
    targets = []
    for subject in (f"{finished.name}{number:02d}" for number in range(subjects)):
        (folder / f"config/subjects/{subject}.yaml").write_text(yaml.safe_dump(settings))
        shutil.copytree(finished, folder / "results" / subject)
        (folder / "captures" / subject).mkdir(parents=True)
        (folder / "captures" / subject / "capture.yaml").touch()  # Of a synthetic capture only this is watched.
        targets.append(f"results/{subject}/metrics.csv")
    cpu_seconds(folder, snakemake("--touch", *targets))
    return targets


def rows_of(root: Path, scratch: Path, finished: Path | None, subjects: Sequence[int]) -> dict[str, Command]:
    """Everything that is measured of a project, by the row it fills."""
    empty = scratch / "empty"
    empty.mkdir(parents=True)
    (empty / "Snakefile").write_text(EMPTY)
    (empty / "made").touch()
    cpu_seconds(empty, snakemake("--touch"))
    rows: dict[str, Command] = {
        "import pandas": (root, ["-c", "import pandas"]),
        **{f"help {stage}": (root, ["-m", f"pipeline.stages.{stage}", "--help"]) for stage in STAGES},
        **{f"import {stage}": (root, ["-c", f"import pipeline.stages.{stage}"]) for stage in STAGES},
        "snakemake, empty project": (empty, snakemake()),
        "snakemake, list of an empty project": (empty, snakemake("--list-rules")),
    }
    project_of(root, scratch / "parsed", None, 0)
    rows["snakemake, list of this project"] = (scratch / "parsed", snakemake("--list-rules"))
    for count in subjects if finished else ():
        folder = scratch / f"subjects{count}"
        targets = project_of(root, folder, finished, count)
        rows[f"snakemake, nothing to do for {count}"] = (folder, snakemake(*targets))
        rows[f"snakemake, dry run for {count}"] = (folder, snakemake("--dry-run", *targets))
    return rows


def measured(columns: Sequence[Mapping[str, Command]], rounds: int) -> dict[str, list[float]]:
    """The least CPU seconds of every row in every column."""
    names = list(columns[0])
    least = {name: [float("inf")] * len(columns) for name in names}
    for _ in range(rounds):
        for name in names:
            found = [cpu_seconds(*commands[name]) for commands in columns]
            least[name] = [min(pair) for pair in zip(least[name], found, strict=True)]
    return least


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--root", type=Path, nargs="+", default=[Path()], help="projects to compare")
    parser.add_argument("--finished", type=Path, help="finished results of a synthetic subject; none: no plans")
    parser.add_argument("--subjects", type=int, nargs="+", default=[1, 20], help="copies of it to plan for")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--only", default="", help="rows whose names have this word")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        roots = [root.resolve() for root in given.root]
        finished = given.finished.resolve() if given.finished else None
        made = [rows_of(root, Path(name, str(i)), finished, given.subjects) for i, root in enumerate(roots)]
        columns = [{row: command for row, command in rows.items() if given.only in row} for rows in made]
        for row, seconds in measured(columns, given.rounds).items():
            print(f"{row:38}" + "".join(f"{value:8.2f}" for value in seconds))


if __name__ == "__main__":
    main()
