"""Coverage of each camera's image by board corners.

Where none were seen, the lens is extrapolated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon

from pipeline.base.verdicts import Grade
from pipeline.calibration.cameras.image_coverage import count_cells
from pipeline.figures.style import (
    BAR_INCHES,
    FAINT,
    INK,
    MUTED,
    add_color_bar,
    add_panels,
    frame_panel,
    grid_size,
    picture,
)
from pipeline.geometry.cameras import Camera

PANEL_INCHES = 1.9
MAP = LinearSegmentedColormap.from_list("seen", ["#cfe1f2", "#4b98ca", "#08306b"])
"""The least is well apart from white, which is not seen at all."""

LEGEND = (
    Patch(facecolor="white", edgecolor=MUTED, hatch="////", label="no corner ever seen", linewidth=0.4),
    Line2D([], [], color=INK, linewidth=1.2, label="hull of all corners"),
    Line2D([], [], color=INK, marker=".", markersize=3, linestyle="", label="corner"),
)


def draw_coverage(
    path: Path, corners: pd.DataFrame, cameras: Mapping[str, Camera], names: Sequence[str], grades: Mapping[str, Grade],
    which: str,
) -> None:  # fmt: skip
    """Write a PNG with one panel per camera of `names`.

    Args:
        corners: columns camera, x, y: residuals_cameras.parquet.
        grades: of the cameras.
        which: the cameras in words, for the header.
    """
    seen = {name: rows[["x", "y"]].to_numpy(np.float64) for name, rows in corners.groupby("camera")}
    counts = {name: count_cells(seen[name], cameras[name].width, cameras[name].height) for name in names}
    scale = Normalize(1, max(2, *(int(count.max()) for count in counts.values())))
    tallest = max(cameras[name].height / cameras[name].width for name in names)
    panel = (PANEL_INCHES, PANEL_INCHES * min(tallest, 1.4))
    size, columns = grid_size(len(names), panel)
    notes = [
        f"Board corners of all views in each camera's image; {which}.",
        "Hatched cells where the person or a light will show: record the board there.",
    ]
    with picture(path, (size[0], size[1] + BAR_INCHES), "Coverage of the image by the board", notes, LEGEND) as figure:
        for axes, name in zip(add_panels(figure, len(names), panel, columns), names, strict=True):
            hull = cv2.convexHull(seen[name].astype(np.float32))
            _draw_cells(axes, cameras[name], counts[name], scale)
            axes.plot(*seen[name].T, ".", color=INK, markersize=2.2, alpha=0.7, markeredgewidth=0)
            axes.add_patch(Polygon(hull[:, 0], fill=False, edgecolor=INK, linewidth=1.2))
            hull_share = cv2.contourArea(hull) / (cameras[name].width * cameras[name].height)
            detail = f"{(counts[name] > 0).mean():.0%} of the cells, hull {hull_share:.0%}"
            frame_panel(axes, name, detail, grades.get(name, "good"))
        add_color_bar(figure, scale, MAP, "corners per cell")


def _draw_cells(axes: Axes, camera: Camera, counts: np.ndarray, scale: Normalize) -> None:
    rows, columns = counts.shape
    axes.set(xlim=(0, camera.width), ylim=(camera.height, 0), aspect="equal", facecolor="white")
    x, y = np.linspace(0, camera.width, columns + 1), np.linspace(0, camera.height, rows + 1)
    axes.pcolormesh(x, y, np.ma.masked_equal(counts, 0), cmap=MAP, norm=scale, edgecolors=FAINT, linewidth=0.3)
    for row, column in np.argwhere(counts == 0):
        corner = (x[column], y[row])
        axes.add_patch(
            Polygon([corner, (x[column + 1], y[row]), (x[column + 1], y[row + 1]), (x[column], y[row + 1])],
                    facecolor="white", edgecolor=MUTED, hatch="////", linewidth=0)
        )  # fmt: skip
