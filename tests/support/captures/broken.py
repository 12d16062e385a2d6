"""Ways to break a capture, and what validation says of a broken one."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from pipeline.base.errors import InputError
from pipeline.capture.index.validation import index_folder
from pipeline.stages.index_capture import run
from tests.support.captures.builder import (
    edit_manifest,
    replace_text,
    write_lines,
)


def read_complaints(capture: Path) -> str:
    with pytest.raises(InputError) as caught:
        index_folder(capture)
    return str(caught.value)


def inspected_by_two(capture: Path, folder: Path) -> tuple[Path, ...]:
    """Tables of two jobs that inspect images: of the first two of three frames, and of the last."""
    run(capture=capture, out=folder, chunk=0, chunks=2, chunk_size=1)
    run(capture=capture, out=folder, chunk=2, chunk_size=1)
    return folder / "0000.parquet", folder / "0002.parquet"


def read_shared_complaints(capture: Path, folder: Path) -> str:
    """What is said of a broken capture whose images two jobs have inspected."""
    with pytest.raises(InputError) as caught:
        run(capture=capture, out=folder / "index", inspected=inspected_by_two(capture, folder / "inspected"))
    return str(caught.value)


Break = Callable[[Path], object]


def manifest(change: Callable[[dict], object]) -> Break:
    return lambda root: edit_manifest(root, change)


def text(name: str, old: str, new: str) -> Break:
    return lambda root: replace_text(root / name, old, new)


def rewritten(name: str, *lines: str) -> Break:
    return lambda root: write_lines(root / name, *lines)


def check_break(capture: Path, tmp_path: Path, how: Break, expected: list[str]) -> None:
    broken = shutil.copytree(capture, tmp_path / "capture", symlinks=True)
    how(broken)
    message = read_complaints(broken)
    for words in expected:
        assert words in message, message
