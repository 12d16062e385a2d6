"""Data beside the repository, for the tests that look at recorded captures and photographs."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

VARIABLE = "LIGHTSTAGE_SHARED_DATA"
"""Names the folder of shared data; without it, that is the folder `shared` beside the repository or inside it."""


def shared_folder() -> Path:
    """The folder of shared data, whether it is there or not."""
    if given := os.environ.get(VARIABLE):
        return Path(given)
    repository = Path(__file__).resolve().parents[2]
    inside = repository / "shared"
    return inside if inside.is_dir() else repository.parent / "shared"


def shared_data(name: str) -> tuple[Path, pytest.MarkDecorator]:
    """A folder of shared data, and the mark that skips tests where it is absent."""
    folder = shared_folder() / name
    reason = f"needs {name}, which is not in {shared_folder().name}/ beside the repository; see ${VARIABLE}"
    return folder, pytest.mark.skipif(not folder.is_dir(), reason=reason)
