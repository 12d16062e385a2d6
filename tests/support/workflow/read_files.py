"""Files that the stages of a run opened, as strace prints them, against those that their rules declare."""

from __future__ import annotations

import base64
import json
import re
from collections import defaultdict
from pathlib import Path

OPENED = re.compile(r'(\d+)<([^>]+)> openat\(AT_FDCWD, "([^"]+)", O_RDONLY')
"""Number of the process, its name, path. Whether the call came to something may stand in a later line."""

BEGINS = "/stage/"
"""Folder, which is not there, of the path that a process tries to open as it becomes a stage; its threads are named
after the stage, as far as Linux keeps names."""

NAME_SIZE = 15


def declared(project: Path) -> dict[str, set[str]]:
    """Inputs and outputs of the jobs of a finished run by rule, as Snakemake keeps them for each output."""
    found: dict[str, set[str]] = defaultdict(set)
    kept = project / ".snakemake/metadata"
    for path in kept.rglob("*"):
        if path.is_file():
            record, name = json.loads(path.read_text()), "".join(path.relative_to(kept).parts).replace("@", "")
            found[record["rule"]] |= {base64.urlsafe_b64decode(name).decode(), *record["input"]}
    return found


def read_results(trace: str, project: Path, stages: set[str]) -> dict[str, set[str]]:
    """Files below results/ that stages opened and that are still there, by stage, relative to the project."""
    stage_of, found = {stage[:NAME_SIZE]: stage for stage in stages}, defaultdict(set)
    project = project.resolve()
    for line in trace.splitlines():
        opened = OPENED.match(line) if BEGINS in line or "results/" in line else None
        if opened is None:
            continue
        number, name, text = opened.groups()
        if text.startswith(BEGINS):
            stage_of[number] = text.removeprefix(BEGINS)
        path, stage = (project / text).resolve(), stage_of.get(number, stage_of.get(name))
        if stage and path.is_relative_to(project / "results") and path.is_file():
            found[stage].add(str(path.relative_to(project)))
    return found


def undeclared(read: dict[str, set[str]], known: dict[str, set[str]]) -> list[tuple[str, str]]:
    """Stage and file of what was read and is neither declared nor in a declared folder.

    A table of digests stands for the folder of the same name beside it.
    """
    found = []
    for stage, paths in read.items():
        allowed = known.get(stage, set()) | {path.removesuffix(".parquet") for path in known.get(stage, set())}
        found += [(stage, path) for path in paths if not {path, *map(str, Path(path).parents)} & allowed]
    return sorted(found)
