"""Subjects of a project, and what can be known of a capture before anything has run."""

from __future__ import annotations

import csv
import functools
import os
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

from pipeline.base.errors import InputError
from pipeline.base.yaml_files import read_yaml
from pipeline.config.datasets import WITHOUT_PROTOCOL
from pipeline.config.loading import Project

UNSPEAKABLE = frozenset("{}\n")
"""Characters that Snakemake takes for more than themselves, and that no path of a capture.yaml can have."""


SHALLOW = 2
"""Folders below that of a public set in which its calibrations and archives lie, and its single images do not."""


def subject_names(project: Project) -> list[str]:
    """Every subject: those whose folder has a capture.yaml, the synthetic and the imported ones."""
    recorded = [path.parent.name for path in Path(project.settings.captures).glob("*/capture.yaml")]
    return sorted({*recorded, *project.synthetic_subjects, *project.imported_subjects})


def require_subject(project: Project, subject: str) -> None:
    """Refuse a subject of which nothing is known.

    Raises:
        InputError: if nothing is known of this subject.
    """
    names = subject_names(project)
    if subject not in names:
        expected = Path(project.settings.captures) / subject / "capture.yaml"
        raise InputError(
            f"subject {subject!r}: expected {expected}, found no such file; subjects: {', '.join(names) or 'none'}. "
            f"Put the capture there, say `--config captures=FOLDER`, or write config/subjects/{subject}.yaml "
            "with `source: synthetic`, or with a public set and its `path`"
        )


def chunk_ids(project: Project, subject: str) -> list[str]:
    """The names of a subject's chunks of frames: 0000, 0001, ...

    A capture whose frames cannot be counted has one chunk: index_capture says what is wrong with it, or the frames of
    an imported one are counted when it is there.
    """
    settings = project.subject(subject)
    if settings.source == "synthetic":
        frames = settings.synthesize_capture.frames
    else:
        frames = _count_frames(Path(project.settings.captures) / subject)
    return list(_chunk_names(max(1, -(-frames // settings.chunk_frames))))


@functools.lru_cache(maxsize=256)
def _chunk_names(count: int) -> tuple[str, ...]:
    return tuple(f"{chunk:04d}" for chunk in range(count))


def watched_files(project: Project, subject: str) -> list[str]:
    """The files whose content decides whether the capture is indexed anew.

    All files of the folder if there are at most `track_capture_files`; else capture.yaml and the tables it names. Of a
    synthetic or imported capture, capture.yaml, which is written last.
    """
    folder = Path(project.settings.captures) / subject
    description = folder / "capture.yaml"
    if project.subject(subject).source != "native":
        return [str(description)]
    if has_few_files(project, subject):
        return sorted(map(str, _files_below(folder)))
    tables = [folder / path for path in _named_files(read_description(description))]
    return sorted(map(str, [description, *(path for path in tables if _is_inside(path, folder))]))


def has_few_files(project: Project, subject: str) -> bool:
    """Tell whether a recorded capture has at most `track_capture_files` files: each is watched."""
    limit = project.settings.track_capture_files
    return len(list(islice(_files_below(Path(project.settings.captures) / subject), limit + 1))) <= limit


def dataset_files(project: Project, subject: str) -> list[str]:
    """The files of a public set whose content decides whether it is imported anew.

    All files if there are at most `track_capture_files`; else those at most two folders deep: calibrations, tables and
    archives, and not one file for each image.

    Raises:
        InputError: if there is no such folder, or scores are to follow a protocol that is not the set's.
    """
    require_own_protocol(project, subject)
    folder, limit = Path(project.subject(subject).path), project.settings.track_capture_files
    if not folder.is_dir():
        expected = f"the folder of a {project.subject(subject).source} capture"
        raise InputError(f"config/subjects/{subject}.yaml: path: expected {expected}, found none: {folder}")
    files = list(islice(_files_below(folder), limit + 1))
    if len(files) > limit:
        files = [path for path in _files_below(folder) if len(path.relative_to(folder).parts) <= SHALLOW + 1]
    return sorted(map(str, files))


def require_own_protocol(project: Project, subject: str) -> None:
    """Refuse the protocol of another public set.

    Raises:
        InputError: if scores are to follow the protocol of a set that the subject is not of.
    """
    settings = project.subject(subject)
    found, source = settings.evaluate_avatar.protocol, settings.source
    if found not in ("ours", source):
        own = "ours" if source in WITHOUT_PROTOCOL else f"ours or {source}"
        raise InputError(
            f"{subject}: evaluate_avatar.protocol: expected {own}, as it is of {source}, found {found}; take the "
            "preset of its own set, if that has one, or none"
        )


def _files_below(folder: Path) -> Iterator[Path]:
    for where, folders, names in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        folders[:] = [name for name in folders if not UNSPEAKABLE & set(name)]
        yield from (Path(where, name) for name in sorted(names) if _can_belong(Path(where, name)))


def _can_belong(path: Path) -> bool:
    """A file that a capture.yaml can name, and a rule can have as input."""
    return not path.name.startswith(".") and not UNSPEAKABLE & set(path.name) and _is_file(path)


def _is_file(path: Path) -> bool:
    """A plain file, no device, link to nothing or loop of links."""
    try:
        return path.is_file()
    except (OSError, RuntimeError):
        return False


def _is_inside(path: Path, folder: Path) -> bool:
    """A plain file below a folder, links followed."""
    return _is_file(path) and path.resolve().is_relative_to(folder.resolve())


def _count_frames(folder: Path) -> int:
    described = folder / "capture.yaml"
    table = _frames_table(described, _changed(described))
    if not table or not _is_inside(folder / table, folder):
        return 0
    return _count_rows(folder / table, _changed(folder / table))


def _changed(path: Path) -> tuple[int, int]:
    """Time of the last change and size, 0 without a file: what is known of an earlier content is asked anew."""
    try:
        found = path.stat()
    except OSError:
        return 0, 0
    return found.st_mtime_ns, found.st_size


@functools.lru_cache(maxsize=256)
def _frames_table(path: Path, _changed: tuple[int, int]) -> str:
    """The table of frames by capture.yaml; empty if there is none. Each of thousands of jobs asks."""
    table = read_description(path).get("frames")
    return table if isinstance(table, str) else ""


@functools.lru_cache(maxsize=256)
def _count_rows(path: Path, _changed: tuple[int, int]) -> int:
    """Rows of a csv table but for its first; 0 if it cannot be read."""
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            return sum(1 for row in csv.reader(file) if row) - 1
    except (OSError, UnicodeDecodeError, csv.Error):
        return 0


def read_description(path: Path) -> dict[str, Any]:
    """The content of a capture.yaml; nothing if it cannot be read, as index_capture says why."""
    try:
        content = read_yaml(path)
    except InputError:
        return {}
    return content if isinstance(content, dict) else {}


def _named_files(content: Any) -> Iterator[str]:
    """Relative paths among the values of a description: texts that are no pattern and stay inside."""
    if isinstance(content, dict):
        for value in content.values():
            yield from _named_files(value)
    elif isinstance(content, str) and "{" not in content and ".." not in Path(content).parts:
        yield content.lstrip("/")
