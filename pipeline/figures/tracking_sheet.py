"""The tracked template laid over images.

Drawn are its outline and level lines, the mask's outline, keypoints seen and projected. A panel shows the part of the
image that the subject is in, at about the panel's own resolution.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D

from pipeline.base.color import srgb_from_linear
from pipeline.base.verdicts import Verdict
from pipeline.figures.style import (
    CROSSHAIR,
    DPI,
    IGNORED,
    OBSERVED,
    PREDICTED,
    PREDICTED_ON_WHITE,
    add_panels,
    frame_panel,
    grid_size,
    picture,
)
from pipeline.figures.surface_lines import seen_lines
from pipeline.figures.tracked_capture import TrackedCapture
from pipeline.geometry.cameras import Camera
from pipeline.geometry.signed_distance import draw_silhouette
from pipeline.geometry.surface_points import SurfacePoints

PANEL_INCHES = (2.4, 3.3)

MARGIN = 0.06
"""Room round the subject, over its longer side."""

MASK = "#cc79a7"

WHITE_PERCENTILE, WHITE_LEVEL = 98.0, 0.55
"""Percentile of the subject's linear values, and the brightness that it is shown with.

So dim frames show, and marks stand out.
"""

LEGEND = (
    Line2D([], [], color=PREDICTED_ON_WHITE, linewidth=1.6, label="tracked: outline, lines on the surface"),
    Line2D([], [], color=MASK, linewidth=1.6, label="mask"),
    Line2D([], [], color=OBSERVED, marker="o", fillstyle="none", linestyle="", label="keypoint detected"),
    Line2D([], [], color=PREDICTED_ON_WHITE, marker=CROSSHAIR, markersize=8, linestyle="", label="keypoint tracked"),
    Line2D([], [], color=IGNORED, marker="o", fillstyle="none", linewidth=1, label="detected elsewhere"),
)


@dataclass(frozen=True)
class Panel:
    """Content of one panel; pixels are those of the reduced image.

    Attributes:
        camera: at the panel's resolution.
        factor: image pixels per pixel of the panel.
        image: sRGB, clipped; None if there is none.
        mask: share of the subject; None if there is none.
        low, high: corners (x, y) of the part that is shown.
        lines: visible pieces of `level_lines`.
    """

    name: str
    row: int
    camera: Camera
    factor: int
    image: Float32[np.ndarray, "height width 3"] | None
    mask: Float32[np.ndarray, "height width"] | None
    low: Float64[np.ndarray, " 2"]
    high: Float64[np.ndarray, " 2"]
    lines: Float64[np.ndarray, "pieces 2 2"]


def read_panel(found: TrackedCapture, lines: SurfacePoints, name: str, row: int) -> Panel:
    """The camera `name` in the `row`th frame."""
    vertices = found.vertices[row].astype(np.float64)
    pixels, depth = found.cameras[name].project(vertices)
    whole = np.array([found.cameras[name].width, found.cameras[name].height], np.float64)
    shown = pixels[(depth > 0) & (pixels > 0).all(1) & (pixels < whole).all(1)]
    low, high = (shown.min(0), shown.max(0)) if len(shown) else (np.zeros(2), whole)
    size = np.array(PANEL_INCHES) * DPI
    factor = max(1, math.floor(((high - low) / size).max()))
    low, high = _framed(low / factor, high / factor)
    camera = found.cameras[name].downsampled(float(factor))
    image, mask = found.image(name, row, factor), found.mask(name, row, factor)
    return Panel(
        name, row, camera, factor, None if image is None else _displayed(image, mask), mask, low, high,
        seen_lines(lines, camera, vertices, found.template.faces),
    )  # fmt: skip


def _framed(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The box with a margin, in the panel's proportions."""
    middle, half = (low + high) / 2, (high - low) / 2 + MARGIN * (high - low).max()
    half = np.array(PANEL_INCHES) * (half / PANEL_INCHES).max()
    return middle - half, middle + half


def _displayed(image: np.ndarray, mask: np.ndarray | None) -> np.ndarray:
    subject = image if mask is None or not (mask > 0.5).any() else image[mask > 0.5]
    white = max(float(np.percentile(subject, WHITE_PERCENTILE)), 1e-6)
    return np.clip(srgb_from_linear(image * np.float32(WHITE_LEVEL / white)), 0, 1)


def draw_sheet(
    path: Path, title: str, found: TrackedCapture, panels: Sequence[Panel], verdicts: Sequence[Verdict],
    outlier_px: float, named: bool = False,
) -> None:  # fmt: skip
    """Write a PNG with one panel per frame of a camera.

    Args:
        verdicts: of the frames, in their order.
        outlier_px: error from which a detected keypoint is shown as one that is elsewhere, image pixels.
        named: whether panels say which camera they show.
    """
    size, columns = grid_size(len(panels), PANEL_INCHES)
    notes = [
        "Every image is brightened on its own. The yellow outline should lie on the pink one, crosses in circles;",
        "yellow lines are fixed to the surface: they should go with limbs and folds from frame to frame.",
    ]
    with picture(path, size, title, notes, LEGEND) as figure:
        for axes, panel in zip(add_panels(figure, len(panels), PANEL_INCHES, columns), panels, strict=True):
            _draw_panel(axes, found, panel, outlier_px)
            row, verdict = found.frames.iloc[panel.row], verdicts[panel.row]
            lit = ", fully lit" if row.fully_lit else ""
            label = f"{panel.name}, frame {row.frame}" if named else f"frame {row.frame}"
            overlap = f", overlap {row.silhouette_iou:.3f}" if np.isfinite(row.silhouette_iou) else ""
            error = f", {row.rms_px:.2f} px" if np.isfinite(row.rms_px) else ""
            frame_panel(axes, label, f"{row.status}{lit}{error}{overlap}", verdict.grade)


def _draw_panel(axes: Axes, found: TrackedCapture, panel: Panel, outlier_px: float) -> None:
    width, height = panel.camera.width, panel.camera.height
    if panel.image is not None:
        axes.imshow(panel.image, extent=(0, width, height, 0), interpolation="nearest")
    drawn = draw_silhouette(panel.camera, found.vertices[panel.row].astype(np.float64), found.template.faces)
    for share, color in ((panel.mask, MASK), (drawn / 255, PREDICTED)):
        if share is not None and share.min() < 0.5 <= share.max():
            x, y = np.arange(width) + 0.5, np.arange(height) + 0.5
            axes.contour(x, y, share, [0.5], colors=[color], linewidths=0.9)
    axes.add_collection(LineCollection(panel.lines, colors=PREDICTED, linewidths=0.5, alpha=0.55))
    camera = list(found.cameras).index(panel.name)
    detected, projected = (points[camera, panel.row] / panel.factor for points in (found.detected, found.projected))
    elsewhere = found.residual_px[camera, panel.row] > outlier_px
    ways = np.stack([detected, projected], 1)[elsewhere]
    axes.add_collection(LineCollection(ways, colors=IGNORED, linewidths=0.9))
    for chosen, color in ((~elsewhere, OBSERVED), (elsewhere, IGNORED)):
        axes.scatter(*detected[chosen].T, s=26, facecolors="none", edgecolors=color, linewidths=0.9)
    axes.scatter(*projected.T, s=26, c=PREDICTED, marker=CROSSHAIR, linewidths=0.8)
    axes.set(xlim=(panel.low[0], panel.high[0]), ylim=(panel.high[1], panel.low[1]), facecolor="#15181c")
