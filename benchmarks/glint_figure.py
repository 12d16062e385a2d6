"""Crops of an eye that looks in several directions under one light, and where its glint should be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from benchmarks.driven_glints import Scene, direction, prepare
from benchmarks.true_eyes import MEASURED
from pipeline.capture.records import FrameRecord
from pipeline.figures.style import CROSSHAIR, PREDICTED, add_panels, frame_panel, grid_size, picture
from pipeline.metrics.comparison import preview_srgb

PANEL_INCHES, MOST, FINER = 2.0, 5, 6
"""Side of a crop, crops in a row, and how much finer those of the lower row are rendered."""

EXPOSURE = 3.0
"""One light of many is dim."""

FOUND = "#56b4e9"
LEGEND = [
    Line2D([], [], color=PREDICTED, marker=CROSSHAIR, linestyle="", markersize=9, label="mirror law, true eye"),
    Line2D([], [], color=FOUND, marker="o", markerfacecolor="none", linestyle="", label="centre of the rendered glint"),
]


def draw_glints(path: Path, scene: Scene, records: Mapping[int, FrameRecord], table: pd.DataFrame) -> None:
    """Write a PNG: the eye, light and camera with most glints on the cornea, two rows of gazes; the upper in pixels of
    the capture."""
    shown = table[(table.status == MEASURED) & (table.sphere == "cornea") & np.isfinite(table.error_px)]
    if shown.empty:
        return
    groups = shown.groupby(["frame", "light", "camera", "eye"])
    _, most = max(groups, key=lambda group: (len(group[1]), group[1].peak.mean()))
    rows = np.linspace(0, len(most) - 1, min(MOST, len(most))).astype(int)
    chosen = most.sort_values(["yaw", "pitch"]).iloc[rows]
    size, columns = grid_size(2 * MOST, (PANEL_INCHES, PANEL_INCHES))
    first, middle = chosen.iloc[0], tuple(chosen[["expected_x", "expected_y"]].mean())
    notes = [
        f"Frame {first.frame}, {first.camera}, {first.light}, {first.eye} eye, one light, {EXPOSURE:g} times brighter.",
        f"Above as the capture's pixels are, below {FINER} times finer.",
    ]
    with picture(path, size, "Glints of turned eyes", notes, LEGEND) as figure:
        panels = add_panels(figure, 2 * MOST, (PANEL_INCHES, PANEL_INCHES), columns)
        for row, zoom in enumerate((1.0, FINER)):
            for axes, (_, glint) in zip(panels[row * columns :], chosen.iterrows(), strict=False):
                show_crop(axes, replace(scene, zoom=zoom), records[glint.frame], glint, middle)
        for axes in panels:
            axes.set_visible(axes.has_data())


def show_crop(axes: Axes, scene: Scene, record: FrameRecord, glint: pd.Series, middle: tuple[float, float]) -> None:
    """One crop around `middle` with both places of its glint, in pixels of the capture."""
    view = scene.around_eyes(record.frame, glint.camera)
    rgb = scene.relighter.view(prepare(scene, record, direction(glint.yaw, glint.pitch), glint.light), view)[0].numpy()
    (left, top), (width, height) = scene.corner(view, glint.camera), np.array([view.width, view.height]) / scene.zoom
    axes.imshow(preview_srgb(EXPOSURE * rgb), extent=(left, left + width, top + height, top), interpolation="nearest")
    marks = {"markerfacecolor": "none", "markersize": 11, "linestyle": ""}
    axes.plot(glint.expected_x, glint.expected_y, marker=CROSSHAIR, color=PREDICTED, **marks)
    axes.plot(glint.found_x, glint.found_y, marker="o", color=FOUND, **marks)
    (x, y), reach = middle, 1.2 * scene.eye_px(record.frame, glint.camera)
    axes.set(xlim=(x - reach, x + reach), ylim=(y + reach, y - reach))
    frame_panel(axes, f"{glint.yaw:+.0f}°, {glint.pitch:+.0f}°", f"{glint.error_px:.2f} px apart")
