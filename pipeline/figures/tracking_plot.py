"""Fit of every frame of a tracking, over time: keypoints, silhouettes, jumps."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from pipeline.base.verdicts import Grade
from pipeline.figures.style import FAINT, GRADE_COLORS, IGNORED, INK, MUTED, picture
from pipeline.figures.tracked_capture import TrackedCapture
from pipeline.figures.tracking_verdicts import jumps_m

STATUS_COLORS = {"refined": "#009e73", "carried": "#56b4e9", "tracked": "#0072b2", "interpolated": "#d55e00",
                 "given": "#0072b2", "between": "#56b4e9", "held": "#d55e00"}  # fmt: skip
"""Of Okabe and Ito's palette."""

HELD_OUT = "#cc79a7"

WIDTH_INCHES, ROW_INCHES, LEFT_INCHES, BELOW_INCHES, GAP_INCHES = 13.0, 1.35, 0.9, 0.5, 0.22

DOT = {"marker": "o", "markersize": 5, "linestyle": ""}


def draw_errors(path: Path, found: TrackedCapture, grades: Sequence[Grade]) -> None:
    """Write a PNG of four rows over one axis of frames.

    Args:
        grades: of the frames, in their order.
    """
    statuses = [status for status in STATUS_COLORS if (found.frames.status == status).any()]
    legend = [
        *(Line2D([], [], color=STATUS_COLORS[status], label=status, **DOT) for status in statuses),
        Line2D([], [], color=HELD_OUT, linewidth=1.2, label="held-out cameras"),
        Line2D([], [], color=INK, marker="|", linestyle="", markersize=8, label="fully lit"),
        *(
            Patch(facecolor=GRADE_COLORS[grade], alpha=0.3, label=f"{grade} frame")
            for grade in ("weak", "failed")
            if grade in grades
        ),
    ]
    notes = [
        "One dot per frame, in the colour of how it was found; held-out cameras (median) took no part in it.",
        "Look for: dots that leave the band of the others, steps where chunks meet (dashed), bands of failed frames.",
    ]
    rows = (_draw_keypoints, _draw_overlap, _draw_counts, _draw_jumps)
    height = len(rows) * (ROW_INCHES + GAP_INCHES) + BELOW_INCHES
    with picture(path, (WIDTH_INCHES, height), "Error per frame", notes, legend) as figure:
        for number, draw in enumerate(rows):
            axes = _add_axes(figure, number)
            _mark_frames(axes, found, grades)
            draw(axes, found)
            axes.set_xlim(found.frames.frame.min() - 1, found.frames.frame.max() + 1)
            axes.tick_params(labelbottom=number == len(rows) - 1)
            # Room below the marks of fully lit frames.
            axes.set_ylim(top=axes.get_ylim()[1] + 0.08 * np.ptp(axes.get_ylim()))
            axes.yaxis.set_label_coords(-0.55 / WIDTH_INCHES, 0.5)
        axes.set_xlabel("frame")


def _add_axes(figure: Figure, number: int) -> Axes:
    width, height = figure.get_size_inches()
    top = figure.subplotpars.top * height - number * (ROW_INCHES + GAP_INCHES) - 0.1
    place = (LEFT_INCHES, top - ROW_INCHES, WIDTH_INCHES - LEFT_INCHES - 0.15, ROW_INCHES)
    return figure.add_axes((place[0] / width, place[1] / height, place[2] / width, place[3] / height))


def _mark_frames(axes: Axes, found: TrackedCapture, grades: Sequence[Grade]) -> None:
    frames = found.frames
    for frame, grade in zip(frames.frame, grades, strict=True):
        if grade != "good":
            axes.axvspan(frame - 0.5, frame + 0.5, color=GRADE_COLORS[grade], alpha=0.3, linewidth=0, zorder=0)
    for first in frames.frame[frames.chunk.diff() > 0]:
        axes.axvline(first - 0.5, color=MUTED, linestyle="--", linewidth=0.7, zorder=0)
    lit = frames.frame[frames.fully_lit]
    axes.plot(lit, np.ones(len(lit)), "|", color=INK, markersize=6, transform=axes.get_xaxis_transform(), clip_on=False)
    axes.grid(axis="y", color=FAINT, linewidth=0.6)
    axes.set_axisbelow(True)


def _draw_dots(axes: Axes, found: TrackedCapture, values: np.ndarray) -> None:
    for status, color in STATUS_COLORS.items():
        chosen = (found.frames.status == status).to_numpy()
        axes.plot(found.frames.frame[chosen], values[chosen], color=color, **DOT | {"markersize": 3.5})


def _draw_keypoints(axes: Axes, found: TrackedCapture) -> None:
    held_out = found.residual_px[~found.trained].transpose(1, 0, 2).reshape(len(found.frames), -1)
    median = np.array([np.nanmedian(row) if np.isfinite(row).any() else np.nan for row in held_out])
    axes.plot(found.frames.frame, median, color=HELD_OUT, linewidth=1.2)
    _draw_dots(axes, found, found.frames.rms_px.to_numpy(np.float64))
    axes.set(ylabel="keypoints'\nerror [px]")
    axes.set_ylim(bottom=0)


def _draw_overlap(axes: Axes, found: TrackedCapture) -> None:
    overlap = found.frames.silhouette_iou.to_numpy(np.float64)
    _draw_dots(axes, found, overlap)
    axes.set(ylabel="silhouettes:\noverlap")
    if np.isfinite(overlap).any():
        # At least five percent: noise does not look like failure.
        axes.set_ylim(min(np.nanmin(overlap) - 0.005, 0.95), 1)
    else:
        axes.text(0.5, 0.5, "no masks", color=MUTED, transform=axes.transAxes, ha="center")


def _draw_counts(axes: Axes, found: TrackedCapture) -> None:
    frames = found.frames
    axes.bar(frames.frame, frames.observations, color=FAINT, width=0.9)
    axes.bar(frames.frame, frames.inliers, color=MUTED, width=0.9)
    axes.set(ylabel="keypoints\nseen, fitting")
    outside = frames.frame[frames.observations == 0]
    axes.plot(outside, np.zeros(len(outside)), "x", color=IGNORED)


def _draw_jumps(axes: Axes, found: TrackedCapture) -> None:
    _draw_dots(axes, found, 1e3 * jumps_m(found))
    axes.set(ylabel="jump out of\nthe path [mm]")
    axes.set_ylim(bottom=0)
