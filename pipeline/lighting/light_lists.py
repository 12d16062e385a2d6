"""Point lights listed in a file: constant, or keyframes in position and intensity."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float64

from pipeline.base.errors import Complaints, InputError
from pipeline.base.files import read_json
from pipeline.capture.index.csv_tables import read_text_cells
from pipeline.lighting.frame_lights import FrameLights

FLOAT32_MAX = float(np.finfo(np.float32).max)
"""Avatars are lit in float32: what is no finite number there is none here."""

NUMBERS = ("x", "y", "z", "r", "g", "b")
COLUMNS = ("light", *NUMBERS)


@dataclass(frozen=True)
class LightList:
    """Keyframes of each light by name.

    Picture numbers, rising, and rows of x, y, z in metres and r, g, b in radiant intensity, linear.
    """

    keys: Mapping[str, tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, "n 6"]]]

    def at(self, picture: int) -> FrameLights:
        """The lights in a picture. Linear between keyframes, constant before the first and after the last."""
        rows = [[np.interp(picture, times, column) for column in rows.T] for times, rows in self.keys.values()]
        values = np.array(rows, np.float64)
        return FrameLights(values[:, :3], values[:, 3:])


def read_light_list(path: Path) -> LightList:
    """Read a .csv table or a .json list of objects.

    They have light, x, y, z, r, g, b and, for keyframes, picture.

    Raises:
        InputError: naming every row that is not finite, is darker than black, or stands twice for one picture.
    """
    table = _read(path)
    missing = sorted(set(COLUMNS) - set(table.columns))
    strange = sorted(set(map(str, table.columns)) - {*COLUMNS, "picture"})
    if missing or strange or table.empty:
        raise InputError(
            f"{path}: expected rows with {', '.join(COLUMNS)} and, if they move, picture; "
            f"found {len(table)} rows, missing {missing}, unknown {strange}"
        )
    table = table.assign(picture=table.get("picture", 0))
    complaints = Complaints(path)
    for row in table.index[table.light.isna() | (table.light.astype(str) == "")]:
        complaints.add(path, f"row {row + 1}", expected="a name in light", found="none")
    numbers = table[["picture", *NUMBERS]].apply(pd.to_numeric, errors="coerce").astype(np.float64)
    for row in table.index:
        values = numbers.loc[row].to_numpy()
        where, found = f"row {row + 1}, light {table.light[row]}", table.loc[row].to_dict()
        if not (np.abs(values) <= FLOAT32_MAX).all():
            complaints.add(path, where, expected="finite numbers", found=str(found))
        elif values[4:].min() < 0:
            complaints.add(path, where, expected="intensities of 0 or more", found=str(found))
    table = numbers.assign(light=table.light.astype(str))
    for light, picture in table[table.duplicated(["light", "picture"])][["light", "picture"]].itertuples(index=False):
        complaints.add(path, f"light {light}", expected=f"one row for picture {picture:g}", found="several")
    complaints.raise_if_any()
    return LightList(
        {
            str(name): (rows.picture.to_numpy(), rows[list(NUMBERS)].to_numpy())
            for name, rows in table.sort_values("picture").groupby("light", sort=False)
        }
    )


def _read(path: Path) -> pd.DataFrame:
    if path.suffix.lower() == ".json":
        content = read_json(path)
        if not isinstance(content, list) or not all(isinstance(row, dict) for row in content):
            raise InputError(f"{path}: expected a list of objects, one per light, found {type(content).__name__}")
        return pd.DataFrame(content)
    try:
        return read_text_cells(path)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: expected a .csv or .json file with lights, found: {error}") from error
