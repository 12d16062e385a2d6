"""Zip archives whose bytes say nothing but what they hold."""

from __future__ import annotations

import zipfile
from collections.abc import Iterable
from pathlib import Path


def write_zip(path: Path, members: Iterable[tuple[str, bytes]]) -> None:
    """Write files by name, without their time: the same files give the same bytes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members:
            archive.writestr(zipfile.ZipInfo(name), content)
