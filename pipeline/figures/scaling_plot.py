"""Cost against size, one panel per case: measurements, fitted laws, and their exponents."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import EngFormatter, FuncFormatter, LogLocator, NullFormatter, NullLocator

from pipeline.figures.style import FAINT, INK, MUTED, picture
from pipeline.metrics.scaling import ScalingLaw

PANEL_INCHES = (2.5, 1.9)
LEFT_INCHES, BELOW_INCHES, ABOVE_INCHES, RIGHT_INCHES = 0.5, 0.5, 0.72, 0.15
COLUMNS = 4

COLORS = {"CPU seconds": "#0072b2", "peak MB": "#b04600"}
"""Of the costs; told apart by colour-blind eyes, and legible as text on white."""

NAMES = {"CPU seconds": "CPU time", "peak MB": "memory"}

LEGEND = [
    Line2D([], [], color=color, marker="o", markersize=4, linewidth=1.1, label=f"{NAMES[cost]} of one run")
    for cost, color in COLORS.items()
]  # fmt: skip


def draw_scaling(path: Path, runs: pd.DataFrame, exponents: pd.DataFrame) -> None:
    """Write a PNG with one panel per stage and varied size.

    Args:
        runs: a row per run: stage, varied, one column per size, and the costs.
        exponents: a row per stage, varied size and cost: fixed, exponent, low, high, predicted, verdict, at_largest.
    """
    cases = exponents[["stage", "varied"]].drop_duplicates().to_records(index=False).tolist()
    columns = min(COLUMNS, len(cases))
    cell = (LEFT_INCHES + PANEL_INCHES[0] + RIGHT_INCHES, ABOVE_INCHES + PANEL_INCHES[1] + BELOW_INCHES)
    size = (max(columns * cell[0], 9.5), math.ceil(len(cases) / columns) * cell[1])
    notes = [
        "Each cost over that of the smallest size. Lines: fixed cost + factor x size^exponent, fitted.",
        "Below the title: the exponent, its 95 % interval, in brackets the predicted one; bold where that is wrong.",
    ]
    with picture(path, size, "How cost grows", notes, LEGEND) as figure:
        for number, (stage, varied) in enumerate(cases):
            axes = _add_axes(figure, *divmod(number, columns), cell)
            own = (runs.stage == stage) & (runs.varied == varied)
            rows = exponents[(exponents.stage == stage) & (exponents.varied == varied)]
            _draw_case(axes, runs[own], rows)


def _add_axes(figure: Figure, row: int, column: int, cell: tuple[float, float]) -> Axes:
    width, height = figure.get_size_inches()
    left = column * cell[0] + LEFT_INCHES
    bottom = figure.subplotpars.top * height - row * cell[1] - ABOVE_INCHES - PANEL_INCHES[1]
    return figure.add_axes((left / width, bottom / height, PANEL_INCHES[0] / width, PANEL_INCHES[1] / height))


def _draw_case(axes: Axes, runs: pd.DataFrame, rows: pd.DataFrame) -> None:
    varied = rows.varied.iloc[0]
    axes.set(xscale="log", yscale="log")
    caption = {"xycoords": "axes fraction", "textcoords": "offset points", "va": "baseline", "size": 8}
    for k, row in enumerate(rows.itertuples()):
        color = COLORS[row.cost]
        first = runs[runs[varied] == row.smallest][row.cost].median()
        axes.plot(runs[varied], runs[row.cost] / first, "o", color=color, markersize=3, alpha=0.7, markeredgewidth=0)
        sizes = np.geomspace(row.smallest, row.largest, 50)
        law = ScalingLaw(row.exponent, row.low, row.high, row.fixed, row.factor)
        axes.plot(sizes, [law.cost(size) / first for size in sizes], color=color, linewidth=1.1)
        text = f"{NAMES[row.cost]} {row.exponent:.2f} [{row.low:.2f}, {row.high:.2f}] ({row.predicted:g})"
        weight = "normal" if row.verdict in ("as predicted", "cannot tell") else "bold"
        axes.annotate(text, (0, 1), (0, 15 - 10 * k), color=color, weight=weight, **caption)
    stage = rows.stage.iloc[0]
    axes.annotate(stage, (0, 1), (0, 27), weight="bold", color=INK, **{**caption, "size": 8.5})
    _label(axes, varied)


def _label(axes: Axes, varied: str) -> None:
    for axis, limits in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        decades = limits[1] / limits[0] >= 1000
        axis.set_major_locator(LogLocator(subs=(1,) if decades else (1, 3)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_locator(NullLocator())
        axis.set_minor_formatter(NullFormatter())
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    low, high = axes.get_ylim()
    if high / low < 3:  # A cost that does not grow is not drawn as if it jumped.
        axes.set_ylim(low / 2, high * 2)
    axes.grid(color=FAINT, linewidth=0.5, zorder=0.5)
    axes.set_axisbelow(True)
    axes.set_xlabel(varied, labelpad=2)
    axes.tick_params(colors=MUTED, labelsize=7.5)
