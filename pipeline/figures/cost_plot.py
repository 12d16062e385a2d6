"""Time against error, one panel per dial.

Shown are the cost of each setting, the Pareto front, and the setting that will do.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter, NullLocator

from pipeline.figures.style import FAINT, GRADE_COLORS, INK, MUTED, picture
from pipeline.metrics.cost import IMPORTS_ONLY

PANEL_INCHES = (3.1, 2.4)
LEFT_INCHES, BELOW_INCHES, ABOVE_INCHES, RIGHT_INCHES = 0.75, 0.55, 0.45, 0.2
COLUMNS = 3

LEAST_RANGE = 2.0
"""Smallest ratio of an axis's ends. 3.0 and 3.1 seconds must not look like a steep curve."""

WIDE_RANGE = 6.0
"""Largest over smallest value from which ticks at 1, 2, 5, 10 ... are enough of them."""

CHARACTER_POINTS = (5.5, 8.5)
"""Width and height of a character, points: what a name takes is estimated, not measured."""

CHOSEN, FRONT, FORBIDDEN = GRADE_COLORS["good"], INK, "#f1f2f4"

DOT = {"color": MUTED, "marker": "o", "markersize": 4, "linestyle": ""}
RING = {
    "color": CHOSEN, "marker": "o", "markersize": 9, "markerfacecolor": "none", "markeredgewidth": 1.8, "linestyle": "",
}  # fmt: skip

LEGEND = (
    Line2D([], [], label="setting, with quartiles of its time", **DOT),
    Line2D([], [], color=FRONT, linewidth=1.1, label="Pareto front"),
    Line2D([], [], label="cheapest within tolerance", **RING),
    Patch(facecolor=FORBIDDEN, label="error above tolerance"),
    Line2D([], [], color=MUTED, linestyle=":", label="imports only"),
)


def draw_costs(path: Path, table: pd.DataFrame, repeats: int) -> None:
    """Write a PNG with one panel per dial, of the metric that decides.

    That is the first metric of each dial.

    Args:
        table: of `pipeline.metrics.cost.cost_table`.
        repeats: runs of each setting, for the header.
    """
    dials = list(dict.fromkeys(table.dial))
    columns = min(COLUMNS, len(dials))
    cell = (LEFT_INCHES + PANEL_INCHES[0] + RIGHT_INCHES, ABOVE_INCHES + PANEL_INCHES[1] + BELOW_INCHES)
    size = (max(columns * cell[0], 9.5), math.ceil(len(dials) / columns) * cell[1])
    notes = [
        f"Wall time of whole stages, median of up to {repeats} runs in turn, against error; down and left is better.",
        "Tolerance: a little above the smallest error, or what images and their noise hardly show (column allowed).",
    ]
    with picture(path, size, "What accuracy costs in time", notes, LEGEND) as figure:
        for number, dial in enumerate(dials):
            rows = table[table.dial == dial]
            axes = _add_axes(figure, number // columns, number % columns, cell)
            _draw_dial(axes, rows[rows.metric == rows.metric.iloc[0]])


def _add_axes(figure: Figure, row: int, column: int, cell: tuple[float, float]) -> Axes:
    width, height = figure.get_size_inches()
    left = column * cell[0] + LEFT_INCHES
    bottom = figure.subplotpars.top * height - row * cell[1] - ABOVE_INCHES - PANEL_INCHES[1]
    return figure.add_axes((left / width, bottom / height, PANEL_INCHES[0] / width, PANEL_INCHES[1] / height))


def _draw_dial(axes: Axes, rows: pd.DataFrame) -> None:
    known = rows[np.isfinite(rows.error)]
    imports = rows[rows.setting == IMPORTS_ONLY]
    chosen = known[known.chosen]
    positive = known.error[known.error > 0]
    allowed = float(rows.allowed.iloc[0])
    low, high = _range([*positive, *([allowed] if allowed > 0 else [])])
    # An error of 0 has no logarithm: it stands on the axis.
    height = known.error.clip(lower=low)
    axes.set(xscale="log", yscale="log", ylim=(low, high))
    axes.set_xlim(*_range([*known.seconds_low, *known.seconds_high, *imports.seconds]))
    axes.axhspan(max(allowed, low), high, color=FORBIDDEN, linewidth=0, zorder=0)
    for seconds in imports.seconds:
        axes.axvline(seconds, color=MUTED, linestyle=":", linewidth=1, zorder=1)
    front = known[known.pareto].sort_values("seconds")
    axes.step(front.seconds, front.error.clip(lower=low), where="post", color=FRONT, linewidth=1.1, zorder=2)
    spread = np.abs(known[["seconds_low", "seconds_high"]].to_numpy().T - known.seconds.to_numpy())
    axes.errorbar(known.seconds, height, xerr=spread, elinewidth=0.9, capsize=2, zorder=3, clip_on=False, **DOT)
    axes.plot(chosen.seconds, chosen.error.clip(lower=low), zorder=4, clip_on=False, **RING)
    _name_settings(axes, known, height.to_numpy())
    _label(axes, rows)


def _name_settings(axes: Axes, known: pd.DataFrame, height: np.ndarray) -> None:
    """Write each setting's name beside its dot.

    It stands in the first of four places where it hides no other name or dot.
    """
    points_per_px = 72 / axes.figure.dpi
    dots = axes.transData.transform(np.stack([known.seconds, height], 1)) * points_per_px
    taken = [(x - 3, y - 3, x + 3, y + 3) for x, y in dots]
    for row, (x, y) in zip(known.itertuples(), dots, strict=True):
        name = f"{row.setting} (error 0)" if row.error == 0 else row.setting
        width = CHARACTER_POINTS[0] * len(name)
        places = [(dx, dy) for dx in (6, -6 - width) for dy in (4, -4 - CHARACTER_POINTS[1])]
        boxes = [(x + dx, y + dy, x + dx + width, y + dy + CHARACTER_POINTS[1]) for dx, dy in places]
        free = [k for k, box in enumerate(boxes) if not any(_overlap(box, other) for other in taken)]
        best = free[0] if free else 0
        taken.append(boxes[best])
        axes.annotate(
            name, (row.seconds, max(row.error, axes.get_ylim()[0])), places[best], textcoords="offset points",
            color=INK, weight="bold" if row.chosen else "normal", zorder=5,
        )  # fmt: skip


def _overlap(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
    return bool(a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3])


def _label(axes: Axes, rows: pd.DataFrame) -> None:
    for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        wide = high / low > WIDE_RANGE
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)) if wide else MaxNLocator(5, steps=[1, 2, 5, 10]))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_locator(NullLocator())
        axis.set_minor_formatter(NullFormatter())
    axes.grid(color=FAINT, linewidth=0.5, zorder=0.5)
    axes.set_axisbelow(True)
    axes.set_xlabel("seconds", labelpad=2)
    caption = {"xycoords": "axes fraction", "textcoords": "offset points", "va": "baseline"}
    failed = rows[~np.isfinite(rows.error) & (rows.setting != IMPORTS_ONLY)].setting
    note = f"; failed: {', '.join(failed)}" if len(failed) else ""
    axes.annotate(rows.dial.iloc[0], (0, 1), (-0.5 * 72 * LEFT_INCHES, 17), weight="bold", color=INK, **caption)
    axes.annotate(rows.metric.iloc[0] + note, (0, 1), (-0.5 * 72 * LEFT_INCHES, 6), size=8, color=MUTED, **caption)


def _range(values: list[float]) -> tuple[float, float]:
    """Limits of a logarithmic axis around positive values."""
    if not values:
        return 0.1, 1.0
    low, high = min(values), max(values)
    margin = max(1.0, math.sqrt(LEAST_RANGE * low / high)) * (high / low) ** 0.12 * 1.06
    return low / margin, high * margin
