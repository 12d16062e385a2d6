"""Tables of the patches of a colour chart: values, linear RGB or CIELAB, and places."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float64

from pipeline.base.errors import Complaints, listed
from pipeline.capture.index.csv_tables import Kind, column_names, complain_rows, read_csv

CLASSIC_PATCHES = 24
"""Patches of a chart whose table does not say where they lie: four rows of six."""

RGB: Mapping[str, Kind] = {"r": "number", "g": "number", "b": "number"}
LAB: Mapping[str, Kind] = {"L": "number", "a": "number", "b": "number"}
PLACE: Mapping[str, Kind] = {"row": "number", "column": "number"}

WHITES = {"D50": (0.96422, 1.0, 0.82521), "D65": (0.95047, 1.0, 1.08883)}
"""X, Y, Z of illuminants for the observer of 2 degrees (ASTM E308)."""

BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
"""Cone responses of Bradford's chromatic adaptation (ICC.1:2010, annex E)."""

RGB_FROM_XYZ = np.array(
    [[3.2404542, -1.5371385, -0.4985314], [-0.9692660, 1.8760108, 0.0415560], [0.0556434, -0.2040259, 1.0572252]]
)
"""Linear sRGB of X, Y, Z under D65 (IEC 61966-2-1)."""

BREAK = 6.0 / 29
"""Of CIELAB's cube root: below, it is a line (CIE 15)."""


@dataclass(frozen=True)
class PatchTable:
    """Patches of a chart.

    Attributes:
        values: linear r, g, b; below 0 for colours that sRGB lacks.
        places: column and row of each patch from 0, in distances of two patches; None for the classic chart.
    """

    values: list[list[float]]
    places: list[list[float]] | None


def linear_from_lab(lab: Float64[np.ndarray, "patches 3"], illuminant: str) -> Float64[np.ndarray, "patches 3"]:
    """Linear sRGB of CIELAB under D50 or D65; white is adapted to that of sRGB (Bradford)."""
    white = np.array(WHITES[illuminant])
    height = (lab[:, 0] + 16) / 116
    f = np.stack([height + lab[:, 1] / 500, height, height - lab[:, 2] / 200], 1)
    xyz = np.where(f > BREAK, f**3, 3 * BREAK**2 * (f - 4 / 29)) * white
    cones = (BRADFORD @ np.array(WHITES["D65"])) / (BRADFORD @ white)
    adapt = np.linalg.inv(BRADFORD) @ np.diag(cones) @ BRADFORD
    return xyz @ (RGB_FROM_XYZ @ adapt).T


def read_patches_csv(root: Path, path: str, illuminant: str, complaints: Complaints) -> PatchTable | None:
    """Patches by their numbers: r, g, b or L, a, b of each, and row and column.

    Without row and column it is the classic chart.

    Args:
        illuminant: of L, a, b.
    """
    names = column_names(root, path)
    colors = LAB if "L" in names else RGB
    placed = PLACE if "row" in names or "column" in names else {}
    table = read_csv(root, path, {"patch": "whole", **colors, **placed}, complaints)
    if table is None:
        return None
    count = len(table) if placed else CLASSIC_PATCHES
    if sorted(table["patch"]) != list(range(1, count + 1)):
        found = f"{len(table)} rows: {listed(list(table['patch']))}"
        hint = "" if placed else "say where the patches of another chart lie: row and column, from 1"
        complaints.add(path, "patch", expected=f"1 to {count}, each once", found=found, hint=hint)
    table = table.sort_values("patch", kind="stable")
    if colors is RGB:
        for channel in RGB:
            if (bad := table[channel] < 0).any():
                complain_rows(complaints, path, channel, bad, "0 or more (linear reflectance)", table[channel])
        values = table[list(RGB)].to_numpy(np.float64)
    else:
        if (bad := ~table["L"].between(0, 100)).any():
            complain_rows(complaints, path, "L", bad, "a lightness, 0 to 100", table["L"])
        values = linear_from_lab(table[list(LAB)].to_numpy(np.float64), illuminant)
    return PatchTable(values.tolist(), _places(path, table, complaints) if placed else None)


def _places(path: str, table: pd.DataFrame, complaints: Complaints) -> list[list[float]]:
    places = table[["column", "row"]].to_numpy(np.float64)
    if len(np.unique(places, axis=0)) < len(places):
        complaints.add(path, "row, column", expected="a place of its own for each patch", found="two in one place")
    if len(places) and (np.ptp(places, axis=0) == 0).any():
        complaints.add(path, "row, column", expected="at least two rows and two columns", found="one")
    return (places - places.min(0)).tolist() if len(places) else []
