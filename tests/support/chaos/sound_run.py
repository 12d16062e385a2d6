"""The finished run of tiny that attacks start from: its files, and the commands that made them."""

from __future__ import annotations

import csv
import io
import os
import re
import shlex
import shutil
import sys
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

from pipeline import STAGES
from pipeline.base.code_digest import KEPT
from pipeline.base.files import digest_file
from tests.support.workflow.project_copy import ProjectCopy
from tests.support.workflow.snakemake_server import SnakemakeServer
from tests.support.workflow.stage_server import StageServer

SUBJECT = "tiny"
CAPTURE = f"captures/{SUBJECT}"
RESULTS = f"results/{SUBJECT}"
TARGET = f"{RESULTS}/metrics.csv"

TIMES = re.compile(r"(^|/)(logs|benchmarks)/|(^|/)(log\.parquet|avatar_times\.csv|events\.out\.[^/]*|\.[^/]*\.log)$")
"""Files of times and measurements: they alone may differ between two runs."""


@dataclass(frozen=True)
class Step:
    """A job of the sound run.

    Attributes:
        stage: module's name.
        words: of its command line.
        reads: files that it reads, as its rule says.
        writes: files that it writes, as its rule says.
    """

    stage: str
    words: tuple[str, ...]
    reads: tuple[str, ...]
    writes: tuple[str, ...]


@dataclass(frozen=True)
class SoundRun:
    """A folder with a capture and its results, and the jobs that made them, in data order."""

    folder: Path
    steps: tuple[Step, ...]

    def step(self, stage: str) -> Step:
        return next(step for step in self.steps if step.stage == stage)

    def before(self, stage: str, folder: Path) -> Path:
        """Copy the run as it was when a stage started into a new folder; files are links to be replaced as a whole."""
        copy_linked(self.folder / CAPTURE, folder / CAPTURE)
        for step in self.steps:
            if step.stage == stage:
                break
            copy_outputs(self.folder, folder, step)
        return folder


def made(root: Path, folder: Path) -> SoundRun:
    """Run tiny in a folder, unless it is there, and read what ran."""
    (root / KEPT).parent.mkdir(exist_ok=True)
    with SnakemakeServer() as server, StageServer() as stages:
        if (folder / "Snakefile").exists():
            project = ProjectCopy(folder, server, stages.python)
        else:
            project = ProjectCopy.made(root, folder, server).with_stages_of(stages)
        done = project.snakemake("--", TARGET)
        assert done.returncode == 0, done.stdout
        done = project.snakemake("--detailed-summary", "--", TARGET)
        assert done.returncode == 0, done.stdout
    return SoundRun(folder, tuple(sorted(_steps(done.stdout), key=lambda step: STAGES.index(step.stage))))


def _steps(summary: str) -> Iterator[Step]:
    """The jobs of Snakemake's detailed summary, in any order."""
    table = io.StringIO(summary[summary.index("output_file\t") :])
    jobs: dict[str, list[dict[str, str]]] = {}
    for row in csv.DictReader(table, delimiter="\t"):
        if row["rule"] and row["shellcmd"] and row["shellcmd"] != "-":
            jobs.setdefault(row["rule"], []).append(row)
    for rows in jobs.values():
        words = shlex.split(rows[0]["shellcmd"].partition(" > ")[0])
        stage = words[words.index("-m") + 1].rpartition(".")[2]
        reads = tuple(name for name in rows[0]["input-file(s)"].split(",") if name)
        yield Step(stage, tuple(words[words.index("-m") + 2 :]), reads, tuple(row["output_file"] for row in rows))


def copy_linked(source: Path, target: Path) -> None:
    """Copy a folder by hard links: what is changed later has to be replaced, and not written into."""
    shutil.copytree(source, target, copy_function=os.link, symlinks=True, dirs_exist_ok=True)


def copy_outputs(source: Path, target: Path, step: Step) -> None:
    """Copy what a step wrote by hard links, with the folder beside a table of the same name."""
    for place in sorted({place for name in step.writes for place in (source / name, (source / name).with_suffix(""))}):
        into = target / place.relative_to(source)
        if into.exists():
            continue
        if place.is_dir():
            copy_linked(place, into)
        elif place.is_file():
            into.parent.mkdir(parents=True, exist_ok=True)
            os.link(place, into)


def digests(folder: Path, below: Collection[str] = (CAPTURE, RESULTS)) -> dict[str, str]:
    """Digest of every file by its path, hidden ones too, but for those of `TIMES`; of links and others their kind."""
    found = {}
    for top in below:
        for parent, _, names in os.walk(folder / top):
            for path in (Path(parent) / name for name in names):
                name = str(path.relative_to(folder))
                if not TIMES.search(name):
                    found[name] = digest_file(path) if path.is_file() else f"no file, {path.lstat().st_mode:o}"
    return found


def differences(expected: dict[str, str], found: dict[str, str]) -> list[str]:
    """Names of files that are missing, left over or other, each with its word."""
    missing = [f"missing: {name}" for name in sorted(expected.keys() - found.keys())]
    more = [f"left over: {name}" for name in sorted(found.keys() - expected.keys())]
    other = [f"other bytes: {name}" for name in sorted(expected.keys() & found.keys()) if expected[name] != found[name]]
    return missing + more + other


if __name__ == "__main__":
    for step in made(Path.cwd(), Path(sys.argv[1])).steps:
        print(step)
