"""Files that the stages of a run opened, as strace prints them, against what Snakemake says that their rules declare."""

from __future__ import annotations

import re
from collections import defaultdict
from pathlib import Path

OPENED = re.compile(r'^\d+<([^>]+)> openat\(AT_FDCWD, "([^"]+)", O_RDONLY', re.MULTILINE)
"""Name of the process, path. Whether the call came to something may stand in a later line."""

NAME_SIZE = 15
"""Characters of a process's name that Linux keeps."""

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
    results = project.resolve() / "results"
    for name, text in OPENED.findall(trace):
        path = (project / text).resolve()
        if name in stage_of and path.is_relative_to(results) and path.is_file():
            found[stage_of[name]].add(str(path.relative_to(project.resolve())))
    return found


def undeclared(read: dict[str, set[str]], known: dict[str, set[str]]) -> list[tuple[str, str]]:
    """Stage and file of what was read and is neither declared nor in a declared folder."""
    return sorted(
        (stage, path)
        for stage, paths in read.items()
        for path in paths
        if not {path, *map(str, Path(path).parents)} & known.get(stage, set())
    )
