"""Files that the stages of a run opened, as strace prints them, against what Snakemake says that their rules declare."""

from __future__ import annotations

import re
from collections import defaultdict
from pathlib import Path

OPENED = re.compile(r'^(\d+)<([^>]+)> openat\(AT_FDCWD, "([^"]+)", O_RDONLY', re.MULTILINE)
"""Number of the process, its name, path. Whether the call came to something may stand in a later line."""

BEGINS = "/stage/"
"""Folder, which is not there, of the path that a process tries to open as it becomes a stage; its threads are named
after the stage, as far as Linux keeps names."""

NAME_SIZE = 15

JOB = re.compile(r"^(?:local)?(?:rule|checkpoint) (\w+):\n((?:    .*\n)+)", re.MULTILINE)
FILES = re.compile(r"^    (?:input|output): (.*)$", re.MULTILINE)


def declared(printed: str) -> dict[str, set[str]]:
    """Inputs and outputs of a run's jobs, by rule, from what Snakemake printed."""
    found: dict[str, set[str]] = defaultdict(set)
    for rule, job in JOB.findall(printed):
        for files in FILES.findall(job):
            found[rule] |= set(re.sub(r" \(.*?\)", "", files).split(", "))
    return found


def read_results(trace: str, project: Path, stages: set[str]) -> dict[str, set[str]]:
    """Files below results/ that stages opened and that are still there, by stage, relative to the project."""
    stage_of, found = {stage[:NAME_SIZE]: stage for stage in stages}, defaultdict(set)
    project = project.resolve()
    for number, name, text in OPENED.findall(trace):
        if text.startswith(BEGINS):
            stage_of[number] = text.removeprefix(BEGINS)
        path, stage = (project / text).resolve(), stage_of.get(number, stage_of.get(name))
        if stage and path.is_relative_to(project / "results") and path.is_file():
            found[stage].add(str(path.relative_to(project)))
    return found


def undeclared(read: dict[str, set[str]], known: dict[str, set[str]]) -> list[tuple[str, str]]:
    """Stage and file of what was read and is neither declared nor in a declared folder."""
    return sorted(
        (stage, path)
        for stage, paths in read.items()
        for path in paths
        if not {path, *map(str, Path(path).parents)} & known.get(stage, set())
    )
