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
from pipeline.lighting.frame_lights import FrameLights

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
    for row in table.index:
        values = pd.to_numeric(table.loc[row, ["picture", *NUMBERS]], errors="coerce").to_numpy(np.float64)
        where, found = f"row {row + 1}, light {table.light[row]}", table.loc[row].to_dict()
        if not np.isfinite(values).all():
            complaints.add(path, where, expected="finite numbers", found=str(found))
        elif values[4:].min() < 0:
            complaints.add(path, where, expected="intensities of 0 or more", found=str(found))
    for light, picture in table[table.duplicated(["light", "picture"])][["light", "picture"]].itertuples(index=False):
        complaints.add(path, f"light {light}", expected=f"one row for picture {picture}", found="several")
    complaints.raise_if_any()
    table = table.assign(**{name: table[name].astype(np.float64) for name in ("picture", *NUMBERS)})
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
        return pd.read_csv(path)
    except (OSError, ValueError) as error:  # pandas' parser errors are ValueErrors
        raise InputError(f"{path}: expected a .csv or .json file with lights, found: {error}") from error
