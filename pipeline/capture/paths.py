"""Paths and path patterns of a capture: relative to its folder, never leaving it.

A pattern is a path with placeholders such as `images/{camera}/{frame:06d}.exr`. Frames and views are whole numbers and
may carry a width; all other placeholders are names. A placeholder may occur more than once.
"""

from __future__ import annotations

import glob
import re
import string
from collections.abc import Collection
from pathlib import Path, PurePosixPath, PureWindowsPath

from pipeline.base.errors import InputError
from pipeline.capture.archives import holder_of

NUMBERS = frozenset({"frame", "view"})
"""Placeholders that stand for whole numbers."""


def check_relative(path: str) -> str:
    """The path in its shortest form.

    Raises:
        ValueError: if it is empty, absolute or climbs with `..`; the message is what was expected.
    """
    if not path.strip() or path.startswith(("/", "~")) or PureWindowsPath(path).drive or "\\" in path:
        raise ValueError("a path relative to the capture folder, with / between its parts")
    shortest = PurePosixPath(path)
    if ".." in shortest.parts:
        raise ValueError("a path that stays inside the capture folder (no ..)")
    return str(shortest)


def check_suffix(path: str, suffixes: Collection[str]) -> str:
    """The path, whose suffix is checked.

    Raises:
        ValueError: if the path ends in none of the suffixes.
    """
    if PurePosixPath(path).suffix.lower() not in suffixes:
        raise ValueError(f"a path that ends in {' or '.join(suffixes)}")
    return path


def check_pattern(pattern: str, placeholders: Collection[str]) -> str:
    """The pattern, whose placeholders are checked.

    Raises:
        ValueError: unless the pattern has exactly these placeholders; the message is what was expected.
    """
    wanted = ", ".join("{" + name + (":06d}" if name in NUMBERS else "}") for name in placeholders)
    expected = f"a path pattern with the placeholders {wanted}"
    try:
        fields = [field for field in string.Formatter().parse(pattern) if field[1] is not None]
    except ValueError as error:
        raise ValueError(f"{expected} ({error})") from error
    for _, name, width, conversion in fields:
        plain = not conversion and re.fullmatch(r"(0?\d+)?d?" if name in NUMBERS else "", width or "")
        if name not in placeholders or not plain:
            raise ValueError(f"{expected} and nothing else in braces")
    if {name for _, name, _, _ in fields} != set(placeholders):
        raise ValueError(expected)
    return pattern


def fill(pattern: str, **values: str | int) -> str:
    """The path that a pattern gives for these values."""
    return pattern.format(**values)


def find_files(root: Path, pattern: str) -> dict[str, dict[str, str | int]]:
    """Values of placeholders by relative path, of files that match a pattern, sorted by path."""
    wildcards, expression, seen = "", "", set()
    for literal, name, _, _ in string.Formatter().parse(pattern):
        wildcards, expression = wildcards + glob.escape(literal), expression + re.escape(literal)
        if name is not None:
            group = f"(?P<{name}>" if name not in seen else "(?:"
            expression += group + (r"\d+)" if name in NUMBERS else "[^/]+)")
            wildcards += "*"
            seen.add(name)
    found = {}
    for path in sorted(glob.glob(wildcards, root_dir=root)):
        path = path.replace("\\", "/")
        if match := re.fullmatch(expression, path):
            values = {name: int(text) if name in NUMBERS else text for name, text in match.groupdict().items()}
            # Filled in again: leaves out 12.png where the pattern says {view:03d}, and differing repeated placeholders.
            if fill(pattern, **values) == path:
                found[path] = values
    return found


SOURCE = "source"
"""The one link that may lead out of a capture: that of import_capture to the set whose images stay where they are."""


def locate(root: Path, path: str, *, imported: bool = False) -> Path:
    """The file of a capture that a relative path names, or the member of an archive.

    Args:
        root: folder of the capture.
        path: as capture.yaml or one of its tables has it.
        imported: True if the capture was imported, so that what lies behind its link `SOURCE` belongs to it.

    Raises:
        InputError: if it is not there or a link leads out of the folder.
    """
    file = root / path
    behind = imported and PurePosixPath(path).parts[:1] == (SOURCE,)
    folder, holder = root / SOURCE if behind else root, holder_of(file)
    try:
        if not holder.resolve().is_relative_to(folder.resolve()):
            raise InputError(
                f"{path}: expected a file inside the capture folder, found a link to {holder.resolve()}; copy it"
            )
        if not holder.is_file():
            raise InputError(f"{path}: expected a file, found {'a folder' if file.is_dir() else 'none'}")
    except (OSError, RuntimeError) as error:  # A loop of links, a name that is too long.
        raise InputError(f"{path}: expected a file, found: {error}") from error
    return file
