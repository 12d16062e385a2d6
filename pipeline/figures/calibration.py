"""Input of a review of a calibration, and all its residuals as one table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float64

from pipeline.base.errors import InputError
from pipeline.base.files import read_json, read_table
from pipeline.base.verdicts import COLUMNS as VERDICT_COLUMNS
from pipeline.base.verdicts import Grade, Verdict
from pipeline.geometry.cameras import Camera, read_cameras

PARTS = ("cameras", "lights", "color")

PATCH_CORNERS = [f"{axis}{corner}" for corner in range(4) for axis in "xy"]
"""Columns of residuals_color.parquet: the corners of each patch's square."""

NUMBERS = ["x", "y", "residual_x", "residual_y", "residual_r", "residual_g", "residual_b", "weight"]
RESIDUAL_COLUMNS = ["kind", "camera", "name", *NUMBERS[:-1], "unit", "weight"]


@dataclass(frozen=True)
class Calibration:
    """Results of the calibrating stages, and the places in the capture where they looked.

    Attributes:
        boards, balls, charts: the index's calibration_cameras.json, _lights.json and _color.json.
        cameras: in the stage's frame.
        lights: lights.parquet.
        survey: index/lights.parquet.
        corrections: corrected-from-raw colour of each camera, 3 x 3.
        corners, highlights, patches: residuals_cameras.parquet, _lights.parquet and _color.parquet.
    """

    subject: str
    black_level: float
    boards: dict[str, Any]
    balls: dict[str, Any]
    charts: dict[str, Any]
    cameras: Mapping[str, Camera]
    lights: pd.DataFrame
    survey: pd.DataFrame
    corrections: Mapping[str, Float64[np.ndarray, "3 3"]]
    corners: pd.DataFrame
    highlights: pd.DataFrame
    patches: pd.DataFrame
    verdicts: list[Verdict]

    def grades(self, kind: str) -> dict[str, Grade]:
        """Name -> grade of one kind of thing."""
        return {verdict.name: verdict.grade for verdict in self.verdicts if verdict.kind == kind}


def read_calibration(index: Path, calibration: Path) -> Calibration:
    """Everything from the folders that index_capture and the calibrating stages wrote.

    Raises:
        InputError: naming a file that is missing or unreadable.
    """
    described = read_json(index / "capture.json")
    residuals = [read_table(calibration / f"residuals_{part}.parquet") for part in PARTS]
    colors = read_json(calibration / "color.json")["cameras"]
    return Calibration(
        described["subject"], described["images"]["black_level"],
        *(read_json(index / f"calibration_{part}.json") for part in PARTS),
        read_cameras(calibration / "cameras.json"), read_table(calibration / "lights.parquet"),
        read_table(index / "lights.parquet"),
        {name: np.asarray(matrix, np.float64) for name, matrix in colors.items()}, *residuals,
        [verdict for part in PARTS for verdict in read_verdicts(calibration / f"verdicts_{part}.csv")],
    )  # fmt: skip


def read_verdicts(path: Path) -> list[Verdict]:
    """Read the verdicts that a stage wrote.

    Raises:
        InputError: if the file is missing or has other columns.
    """
    try:
        table = pd.read_csv(path, dtype=str, keep_default_na=False)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: expected a table of verdicts, found: {error}") from error
    if list(table.columns) != VERDICT_COLUMNS:
        raise InputError(f"{path}: expected the columns {VERDICT_COLUMNS}, found {list(table.columns)}")
    return [Verdict(*row) for row in table.itertuples(index=False)]


def residual_table(found: Calibration) -> pd.DataFrame:
    """One row per observation; residuals are predicted minus observed throughout.

    Columns: kind (corner, highlight or patch); camera; name (view/board/corner, light/position, or patch); x, y: where
    it is in the camera's image, pixels; residual_x, residual_y for corners and highlights, residual_r, residual_g,
    residual_b for patches (raw linear colour), NaN otherwise; unit of the residuals (px or full scale); weight in the
    robust fit, 1 = fully counted.
    """
    corners, highlights, patches = found.corners, found.highlights, found.patches
    colors = ["residual_r", "residual_g", "residual_b"]
    parts = [
        corners.assign(kind="corner", unit="px", name=_joined(corners, "view", "board", "corner")),
        highlights.assign(kind="highlight", unit="px", name=_joined(highlights, "light", "position")),
        patches.assign(
            kind="patch", unit="full scale", name=_joined(patches, "patch"),
            x=patches[PATCH_CORNERS[::2]].mean(axis=1), y=patches[PATCH_CORNERS[1::2]].mean(axis=1),
            # The stage writes observed minus fitted.
            **(-patches[colors].astype(np.float64)),
        ),
    ]  # fmt: skip
    table = pd.concat([part.reindex(columns=RESIDUAL_COLUMNS) for part in parts], ignore_index=True)
    return table.astype({name: "float64" if name in NUMBERS else "str" for name in RESIDUAL_COLUMNS})


def _joined(table: pd.DataFrame, *columns: str) -> list[str]:
    return ["/".join(map(str, row)) for row in table[list(columns)].itertuples(index=False)]
