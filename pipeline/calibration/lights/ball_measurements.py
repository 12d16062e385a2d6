"""Measurements in photographs of mirror balls, by one job or several with some cameras each."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float64

from pipeline.base.errors import InputError
from pipeline.base.files import read_table, write_table
from pipeline.calibration.lights.ball_photos import CHANNELS, SPOT_COLUMNS, Key, find_outlines, find_spots

FLUXES = ["flux", *(f"flux_{channel}" for channel in CHANNELS)]

TYPES = {
    "what": "str", "position": "str", "camera": "str", "light": "str", "x": "float64", "y": "float64",
    "saturated": "bool", "distance": "float64", **dict.fromkeys(FLUXES, "float64"), "why": "str",
}  # fmt: skip
"""Columns of a table of measurements: a row for each point of an outline, photograph without one, and spot."""


@dataclass(frozen=True)
class BallMeasurements:
    """Outlines and spots that were measured in photographs.

    Attributes:
        outlines: of balls, in pixels, by position and camera.
        refused: what an image holds in place of a ball.
        spots: bright spots on balls, as `find_spots` lists them.
    """

    outlines: dict[Key, Float64[np.ndarray, "_ 2"]]
    refused: dict[Key, str]
    spots: pd.DataFrame


def measure_balls(capture: Path, calibration: dict[str, Any], lights: Iterable[str], threads: int) -> BallMeasurements:
    """Measure all photographs of calibration_lights.json."""
    outlines, refused = find_outlines(capture, calibration)
    return BallMeasurements(outlines, refused, find_spots(capture, calibration, outlines, lights, threads))


def of_cameras(calibration: dict[str, Any], share: int, shares: int) -> dict[str, Any]:
    """calibration_lights.json with the photographs of every `shares`-th camera alone."""
    lists = ("images", "silhouettes")
    names = sorted({entry["camera"] for key in lists for entry in calibration[key]})
    chosen = set(names[share::shares])
    return {**calibration, **{key: [e for e in calibration[key] if e["camera"] in chosen] for key in lists}}


def write_measurements(path: Path, found: BallMeasurements) -> None:
    """Write the table of one job's measurements."""
    rows = [
        {"what": "outline", "position": position, "camera": camera, "x": x, "y": y}
        for (position, camera), points in found.outlines.items()
        for x, y in points.tolist()
    ]
    rows += [{"what": "refused", "position": p, "camera": c, "why": why} for (p, c), why in found.refused.items()]
    table = pd.concat([pd.DataFrame(rows, columns=list(TYPES)), found.spots.assign(what="spot")], ignore_index=True)
    texts = {name: table[name].astype(object).where(table[name].notna(), "") for name in ("light", "why")}
    flags = table["saturated"].map(lambda value: value is True or value is np.True_)
    write_table(path, table.assign(**texts, saturated=flags)[list(TYPES)].astype(TYPES))


def read_measurements(paths: Sequence[Path], calibration: dict[str, Any]) -> BallMeasurements:
    """Measurements of several jobs, in the order in which one would have made them.

    Raises:
        InputError: if a file is no such table.
    """
    tables = []
    for path in paths:
        tables.append(table := read_table(path))
        if list(table.columns) != list(TYPES):
            raise InputError(f"{path}: expected columns {', '.join(TYPES)}, found {', '.join(table.columns)}")
    table = pd.concat(tables, ignore_index=True)
    keys = [(entry["position"], entry["camera"]) for entry in calibration["silhouettes"]]
    points = dict(iter(table[table.what == "outline"].groupby(["position", "camera"])))
    outlines = {key: points[key][["x", "y"]].to_numpy(np.float64) for key in keys if key in points}
    why = table[table.what == "refused"].set_index(["position", "camera"]).why.to_dict()
    entries = [(entry["light"], entry["position"], entry["camera"]) for entry in calibration["images"]]
    order = {entry: place for place, entry in enumerate(entries)}
    spots = table[table.what == "spot"]
    places = [order[row] for row in zip(spots.light, spots.position, spots.camera, strict=True)]
    spots = spots.iloc[np.argsort(places, kind="stable")][[*SPOT_COLUMNS, *FLUXES]].reset_index(drop=True)
    return BallMeasurements(outlines, {key: why[key] for key in keys if key in why}, spots)
