"""Tables that drive a head in place of what was filmed. Latent codes, and where its eyes look, by picture."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float, Float32, Float64

from pipeline.base.errors import Complaints, InputError, listed
from pipeline.capture.index.csv_tables import (
    Kind,
    column_names,
    complain_repeats,
    complain_rows,
    complain_unknown,
    read_csv,
)
from pipeline.capture.index.eye_tables import UNIT_TOLERANCE, between_directions

GAZE_COLUMNS: Mapping[str, Kind] = {"picture": "number", "eye": "name", "x": "number", "y": "number", "z": "number"}


@dataclass(frozen=True)
class KeyedCodes:
    """Latent codes at numbers of pictures, rising."""

    pictures: Float64[np.ndarray, " n"]
    codes: Float64[np.ndarray, "n code"]

    @property
    def count(self) -> int:
        """Pictures up to the last row."""
        return max(1, int(self.pictures[-1]) + 1)

    def at(self, picture: int) -> Float32[np.ndarray, " code"]:
        """The code of a picture: linear between rows, constant before the first and after the last."""
        return np.array([np.interp(picture, self.pictures, column) for column in self.codes.T], np.float32)


@dataclass(frozen=True)
class KeyedGaze:
    """Unit directions of each eye in the head's frame, at numbers of pictures, rising."""

    eyes: Sequence[tuple[Float64[np.ndarray, " _"], Float64[np.ndarray, "_ 3"]]]

    def at(self, picture: int) -> Float32[np.ndarray, "eyes 3"]:
        """Gaze in a picture. On the great circle between rows, constant before and after them."""
        looks = []
        for pictures, directions in self.eyes:
            row, share = divmod(np.interp(picture, pictures, np.arange(len(pictures))), 1)
            ends = directions[[int(row), min(int(row) + 1, len(directions) - 1)]]
            looks.append(between_directions(ends[:1], ends[1:], np.array([share]))[0])
        return np.array(looks, np.float32)


def code_columns(size: int) -> list[str]:
    """The names of a code's numbers."""
    return [f"code_{number}" for number in range(size)]


def code_table(codes: Float[np.ndarray, "pictures code"]) -> pd.DataFrame:
    """The codes of pictures 0, 1, ... as the table that `read_codes` reads."""
    return pd.DataFrame(codes, columns=code_columns(codes.shape[1])).rename_axis("picture").reset_index()


def read_codes(path: Path, size: int) -> KeyedCodes:
    """Read a table with `picture` and the numbers of a code.

    Raises:
        InputError: if it is not of codes of `size` numbers, or names what is not a number, or a picture twice.
    """
    columns, found = ["picture", *code_columns(size)], _columns(path)
    if found and sorted(found) != sorted(columns):
        raise InputError(
            f"{path}: expected the columns picture and code_0 to code_{size - 1}, as the avatar's codes have {size} "
            f"numbers; found {listed(found)}"
        )
    table = _read(path, dict.fromkeys(columns, "number"), ["picture"]).sort_values("picture")
    return KeyedCodes(table["picture"].to_numpy(), table[columns[1:]].to_numpy())


def read_gaze_table(path: Path, eyes: Collection[str]) -> KeyedGaze:
    """Read a table with `picture`, `eye`, `x`, `y`, `z`.

    Args:
        eyes: names of the avatar's eyes, in its order.

    Raises:
        InputError: naming every row of another eye, that is no unit direction, or that stands twice for one picture.
    """
    complaints = Complaints(path)
    table = _read(path, GAZE_COLUMNS, ["picture", "eye"])
    length = np.linalg.norm(table[["x", "y", "z"]], axis=1)
    if (bad := pd.Series(np.abs(length - 1) > UNIT_TOLERANCE)).any():
        lengths = pd.Series(length).map("length {:.3g}".format)
        complain_rows(complaints, path.name, "x, y, z", bad, "a unit direction", lengths)
    complain_unknown(complaints, path.name, "eye", table["eye"], eyes, "the avatar")
    if missing := [name for name in eyes if name not in set(table["eye"])]:
        complaints.add(path.name, "eye", expected=f"directions of {listed(eyes)}", found=f"none of {listed(missing)}")
    complaints.raise_if_any()
    table = table.assign(**{axis: table[axis] / length for axis in "xyz"}).sort_values("picture")
    own = (table[table["eye"] == name] for name in eyes)
    return KeyedGaze([(rows["picture"].to_numpy(), rows[list("xyz")].to_numpy()) for rows in own])


def fixed_gaze(direction: Sequence[float], eyes: Collection[str]) -> KeyedGaze:
    """One direction for all eyes and pictures.

    Raises:
        InputError: if it is no unit direction.
    """
    looks = np.array(direction, np.float64)
    length = np.linalg.norm(looks)
    if looks.shape != (3,) or not abs(length - 1) <= UNIT_TOLERANCE:
        raise InputError(f"--gaze-direction: expected three numbers, a unit direction, found {listed(direction)}")
    return KeyedGaze([(np.zeros(1), looks[None] / length)] * len(eyes))


def _columns(path: Path) -> list[str]:
    file = path.resolve()  # what a link leads to may lie anywhere
    return column_names(file.parent, file.name)


def _read(path: Path, columns: Mapping[str, Kind], keys: list[str]) -> pd.DataFrame:
    """A table with at least one row and no repeated keys."""
    complaints = Complaints(path)
    file = path.resolve()
    table = read_csv(file.parent, file.name, columns, complaints)
    if table is not None and table.empty:
        complaints.add(path.name, "table", expected="at least one row", found="none")
    if table is not None:
        complain_repeats(complaints, path.name, table, keys)
    complaints.raise_if_any()
    return table
