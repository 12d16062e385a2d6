"""Detected and projected board corners drawn on each camera's worst image.

If that is right, all are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import UInt8
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from pipeline.base.verdicts import Grade
from pipeline.figures.style import (
    CROSSHAIR,
    IGNORED,
    IGNORED_WEIGHT,
    OBSERVED,
    PREDICTED,
    PREDICTED_ON_WHITE,
    add_panels,
    frame_panel,
    grid_size,
    picture,
    rms,
    show_gray,
)

PANEL_INCHES = 2.4

MARGIN = 0.25
"""Room round the corners, over the longer side of their box: the board's rim shows."""

LEGEND = (
    Line2D([], [], color=OBSERVED, marker="o", fillstyle="none", linestyle="", label="detected"),
    Line2D([], [], color=PREDICTED_ON_WHITE, marker=CROSSHAIR, markersize=9, linestyle="", label="projected"),
    Line2D([], [], color=IGNORED, marker="o", fillstyle="none", linestyle="", label="detected, left out by the fit"),
)


@dataclass(frozen=True)
class BoardView:
    """One image of a board: its pixels, and its rows of residuals_cameras.parquet."""

    camera: str
    gray: UInt8[np.ndarray, "height width"]
    corners: pd.DataFrame


def worst_view(corners: pd.DataFrame) -> int:
    """View of one camera in which the fit leaves the largest residuals.

    `corners` are its rows of residuals_cameras.parquet.
    """
    misfit = {view: rms(rows[["residual_x", "residual_y"]].to_numpy()) for view, rows in corners.groupby("view")}
    return int(max(misfit, key=lambda view: misfit[view]))


def draw_corners(path: Path, views: list[BoardView], grades: Mapping[str, Grade], which: str) -> None:
    """Write a PNG with one panel per camera.

    Args:
        grades: of the cameras.
        which: the cameras in words, for the header.
    """
    panel = (PANEL_INCHES, PANEL_INCHES)
    size, columns = grid_size(len(views), panel)
    notes = [f"The view that fits worst, of {which}. Each circle should hold a cross and a corner of the board."]
    with picture(path, size, "Board corners", notes, LEGEND) as figure:
        for axes, view in zip(add_panels(figure, len(views), panel, columns), views, strict=True):
            _draw_view(axes, view)
            residual = view.corners[["residual_x", "residual_y"]].to_numpy(np.float64)
            detail = f"view {view.corners['view'].iloc[0]}, {len(residual)} corners, {rms(residual):.3f} px RMS"
            frame_panel(axes, view.camera, detail, grades.get(view.camera, "good"))


def _draw_view(axes: Axes, view: BoardView) -> None:
    observed = view.corners[["x", "y"]].to_numpy(np.float64)
    projected = observed + view.corners[["residual_x", "residual_y"]].to_numpy(np.float64)
    ignored = view.corners.weight.to_numpy() < IGNORED_WEIGHT
    middle = (observed.min(0) + observed.max(0)) / 2
    half = (0.5 + MARGIN) * float(np.ptp(observed, axis=0).max())
    # Moved into the image, if it fits.
    room = np.array(view.gray.shape[::-1]) - half
    middle = np.where(room > half, np.clip(middle, half, np.maximum(room, half)), middle)
    low = np.clip(np.floor(middle - half), 0, None).astype(int)
    high = np.ceil(middle + half).astype(int)
    part = view.gray[low[1] : high[1], low[0] : high[0]]
    # White squares are shown at half brightness: the marks stand out on them.
    white = max(float(np.percentile(part, 98)), 1.0)
    show_gray(axes, part, (int(low[0]), int(low[1])), dark=0.0, white=2 * white)
    for rows, color in ((~ignored, OBSERVED), (ignored, IGNORED)):
        axes.scatter(*observed[rows].T, s=42, facecolors="none", edgecolors=color, linewidths=1.1)
    axes.scatter(*projected.T, s=90, c=PREDICTED, marker=CROSSHAIR, linewidths=1.0)
    axes.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] + half, middle[1] - half), facecolor="#eceef1")
