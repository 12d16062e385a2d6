"""Mirror balls as the cameras see them, with outlines and highlights.

Outlines are those found; highlights are drawn where they were measured and where they are predicted.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float32, Float64
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from pipeline.base.color import srgb_from_linear
from pipeline.base.verdicts import Grade
from pipeline.calibration.lights.ball_photos import read_ball_photo
from pipeline.capture.images import Transfer
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
OUTLINE = "#cc79a7"

MARGIN = 0.12
"""Room round the outline, over its diameter."""

LEGEND = (
    Line2D([], [], color=OUTLINE, linewidth=1.4, label="outline found"),
    Line2D([], [], color=OBSERVED, marker="o", fillstyle="none", linestyle="", label="highlight found"),
    Line2D([], [], color=PREDICTED_ON_WHITE, marker=CROSSHAIR, markersize=9, linestyle="", label="highlight predicted"),
    Line2D([], [], color=IGNORED, marker="o", fillstyle="none", linestyle="", label="found, left out by the fit"),
)


LABEL_BOX = {"facecolor": "black", "alpha": 0.6, "linewidth": 0, "pad": 0.8}

WHITE_PERCENTILE = 99.8
"""Percentile of the brightness that is shown as white.

Sixty highlights of ten pixels each are a hundredth of the picture, their peaks less.
"""


@dataclass(frozen=True)
class BallView:
    """One ball in one camera.

    Attributes:
        name: how position and camera are called together.
        gray: brightest of the lit images, linear, inside `low` (x, y) and the array's size.
        outline: of the ball, pixels of the whole image.
        highlights: rows of residuals_lights.parquet.
    """

    name: str
    gray: Float32[np.ndarray, "height width"]
    low: tuple[int, int]
    outline: Float64[np.ndarray, "points 2"]
    highlights: pd.DataFrame


def read_ball_view(
    name: str, outline: Float64[np.ndarray, "points 2"], images: Iterable[Path], transfer: Transfer,
    highlights: pd.DataFrame,
) -> BallView:  # fmt: skip
    """The part of `images` round the outline, brightest of all; black if there are none."""
    room = MARGIN * np.ptp(outline, axis=0).max()
    low = np.maximum(np.floor(outline.min(0) - room), 0).astype(int)
    high = np.ceil(outline.max(0) + room).astype(int)
    gray = np.zeros((1, 1), np.float32)
    for path in images:
        image, _ = read_ball_photo(path, transfer)
        gray = np.maximum(gray, image[low[1] : high[1], low[0] : high[0]].mean(2))
    return BallView(name, gray, (int(low[0]), int(low[1])), outline, highlights)


def draw_balls(path: Path, views: list[BallView], grades: Mapping[str, Grade], which: str) -> None:
    """Write a PNG with one panel per view.

    Args:
        grades: of the lights.
        which: the views in words, for the header.
    """
    panel = (PANEL_INCHES, PANEL_INCHES)
    size, columns = grid_size(len(views), panel)
    notes = [
        f"The brightest of the images in which one light each is on, brightened; {which}.",
        "Each circle should hold a cross and a highlight. Named: lights that are not good, and what is left out.",
    ]
    with picture(path, size, "Mirror balls", notes, LEGEND) as figure:
        for axes, view in zip(add_panels(figure, len(views), panel, columns), views, strict=True):
            _draw_view(axes, view, grades)
            residual = view.highlights[["residual_x", "residual_y"]].to_numpy(np.float64)
            detail = f"{len(residual)} highlights" + (f", {rms(residual):.3f} px RMS" if len(residual) else "")
            frame_panel(axes, view.name, detail)


def _draw_view(axes: Axes, view: BallView, grades: Mapping[str, Grade]) -> None:
    dark, white = np.percentile(view.gray, (50, WHITE_PERCENTILE))
    shown = np.clip((view.gray - dark) / max(white - dark, 1e-6), 0, 1)
    show_gray(axes, srgb_from_linear(shown), view.low, dark=-0.1, white=1.0)
    axes.plot(*np.concatenate([view.outline, view.outline[:1]]).T, color=OUTLINE, linewidth=0.9)
    found = view.highlights[["x", "y"]].to_numpy(np.float64)
    predicted = found + view.highlights[["residual_x", "residual_y"]].to_numpy(np.float64)
    ignored = view.highlights.weight.to_numpy(np.float64) < IGNORED_WEIGHT
    for rows, color in ((~ignored, OBSERVED), (ignored, IGNORED)):
        axes.scatter(*found[rows].T, s=42, facecolors="none", edgecolors=color, linewidths=0.8)
    axes.scatter(*predicted.T, s=70, c=PREDICTED, marker=CROSSHAIR, linewidths=0.8)
    middle = (view.outline.min(0) + view.outline.max(0)) / 2
    for light, pixel, odd in zip(view.highlights.light, found, ignored, strict=True):
        if odd or grades.get(light, "good") != "good":
            side = 1 if pixel[0] < middle[0] else -1  # Towards the middle: names stay in the panel.
            place = {"xytext": (5 * side, 4), "textcoords": "offset points", "ha": "left" if side > 0 else "right"}
            axes.annotate(light, pixel, color="white", size=7, bbox=LABEL_BOX, **place)
    half = (0.5 + MARGIN) * np.ptp(view.outline, axis=0).max()
    axes.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] + half, middle[1] - half), facecolor="black")
