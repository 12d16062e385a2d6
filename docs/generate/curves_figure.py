"""Draw the committed curves of all subjects, one panel per dial: docs/pictures/curves.png.

    python -m docs.generate.curves_figure

A setting's error stands over what is allowed, so that dials can be compared; its time over that of the default.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import tyro
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from pipeline.base.code_digest import ROOT
from pipeline.budget.curve import LEAST_ALLOWED, Curve
from pipeline.budget.curves import FOLDER, read_curves
from pipeline.budget.subject_curve import SubjectCurve, parse_setting
from pipeline.figures.style import INK, MUTED, picture

PANEL_INCHES = (2.6, 1.9)
LEFT_INCHES, BELOW_INCHES, ABOVE_INCHES, RIGHT_INCHES = 0.55, 0.45, 0.35, 0.15
COLUMNS = 3

COLORS = ("#1f6feb", "#d1742f", "#2a9d5c", "#8b5cf6", "#c2255c")
"""Of the subjects, in their order."""

WIDE_DECADES = 1.5
"""Decades of time from which ticks at powers of ten are enough."""

FLOOR, CEILING = 0.03, 30.0
"""Errors over what is allowed that are drawn; smaller ones, and gains, stand on the lower edge."""


def run(*, curves: Path = ROOT / FOLDER / "accuracy_cost.csv", out: Path = ROOT / "docs/pictures/curves.png") -> None:
    """Write the picture.

    Args:
        curves: the table.
        out: the picture.
    """
    dials = read_curves(curves)
    subjects = list(dict.fromkeys(part.subject for curve in dials for part in curve.parts))
    cell = (LEFT_INCHES + PANEL_INCHES[0] + RIGHT_INCHES, ABOVE_INCHES + PANEL_INCHES[1] + BELOW_INCHES)
    rows = math.ceil(len(dials) / COLUMNS)
    notes = [
        "Error over what images and their noise hardly show, against time over that of the default setting.",
        "Vertical bars are standard errors over frames and trainings; what gains stands on the lower edge.",
    ]
    legend = [
        Line2D([], [], color=color, marker="o", label=name) for name, color in zip(subjects, COLORS, strict=False)
    ]
    with picture(out, (COLUMNS * cell[0], rows * cell[1]), "What settings cost, and lose", notes, legend) as figure:
        width, height = figure.get_size_inches()
        for number, curve in enumerate(dials):
            left = number % COLUMNS * cell[0] + LEFT_INCHES
            bottom = figure.subplotpars.top * height - (number // COLUMNS) * cell[1] - ABOVE_INCHES - PANEL_INCHES[1]
            axes = figure.add_axes((left / width, bottom / height, PANEL_INCHES[0] / width, PANEL_INCHES[1] / height))
            draw_curve(axes, curve, dict(zip(subjects, COLORS, strict=False)))


def draw_curve(axes: Axes, curve: Curve, colors: dict[str, str]) -> None:
    """Draw a dial: a line per subject, and the names of the settings at the first one's."""
    axes.set(xscale="log", yscale="log", ylim=(FLOOR, CEILING))
    axes.axhspan(FLOOR, 1.0, color="#eef6ee", linewidth=0, zorder=0)
    axes.axvline(1.0, color=MUTED, linestyle=":", linewidth=0.9)
    axes.set_title(f"{curve.stage}.{curve.option}", fontsize=8, color=INK, loc="left")
    for part in curve.parts:
        times, losses, errors = points(part, curve)
        shown = np.clip(losses, FLOOR, CEILING)
        bars = [shown - np.clip(losses - errors, FLOOR, CEILING), np.clip(losses + errors, FLOOR, CEILING) - shown]
        style = {"color": colors[part.subject], "markersize": 4, "linewidth": 1.1, "elinewidth": 0.8, "clip_on": False}
        axes.errorbar(times, shown, yerr=bars, fmt="o-", **style)
    times, losses, _ = points(curve.parts[0], curve)
    for name, x, y in zip(curve.parts[0].settings, times, np.clip(losses, FLOOR, CEILING), strict=True):
        below = y > CEILING / 2  # the title stands above
        place = (4, -9 if below else 4)
        axes.annotate(name, (x, y), textcoords="offset points", xytext=place, fontsize=6.5, color=MUTED)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    wide = np.ptp(np.log10(times)) > WIDE_DECADES
    axes.xaxis.set_major_locator(LogLocator(subs=(1,) if wide else (1, 2, 5)))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.tick_params(labelsize=7)


def points(part: SubjectCurve, curve: Curve) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times over the default's, errors over what is allowed, and their standard errors, of all settings."""
    values = [parse_setting(name) for name in part.settings]
    times = np.array([part.work(value) / part.work(curve.default) for value in values])
    allowed = max(part.allowed, LEAST_ALLOWED)
    return times, np.array(part.errors) / allowed, np.array([part.scatter(value) for value in values]) / allowed


if __name__ == "__main__":
    tyro.cli(run)
