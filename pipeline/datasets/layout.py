"""Files that a set has to hold: those that are missing are named with what makes them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from pipeline.base.errors import Complaints, InputError
from pipeline.base.files import read_json


def require(root: Path, files: Mapping[str, str], complaints: Complaints) -> None:
    """Complain about files or folders that are not there; the values say where they come from."""
    for name, origin in files.items():
        if not (root / name).exists():
            complaints.add(name, "file", expected="one", found="none", hint=origin)


def find_shared(root: Path) -> Path:
    """The folder `shared` of a capture, of the folder that it lies in, or of the one above."""
    places = [folder / "shared" for folder in (root, root.parent, root.parent.parent)]
    return next((place for place in places if place.is_dir()), places[0])


def json_key(path: Path, key: str) -> Any:
    """The value of a key of a JSON file.

    Raises:
        InputError: if the file cannot be read or has no such key.
    """
    content = read_json(path)
    if not isinstance(content, dict) or key not in content:
        found = f"the keys {', '.join(content)}" if isinstance(content, dict) else type(content).__name__
        raise InputError(f"{path}: {key}: expected this key, found {found}")
    return content[key]


def csv_columns(path: Path, columns: tuple[str, ...]) -> pd.DataFrame:
    """Columns of a csv file, others left out.

    Raises:
        InputError: if the file cannot be read or lacks one.
    """
    try:
        table = pd.read_csv(path)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: expected a csv table, found: {error}") from error
    if missing := [column for column in columns if column not in table]:
        raise InputError(f"{path}: columns: expected {', '.join(columns)}, found no {', '.join(missing)}")
    return table[list(columns)]
