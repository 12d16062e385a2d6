"""Histogram of residuals over their noise, against the normal curve.

It shows whether the noise is as the fit assumes.
"""

from __future__ import annotations

from pathlib import Path
from statistics import NormalDist

import numpy as np
import pandas as pd
from jaxtyping import Float64
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from pipeline.figures.style import GAP_INCHES, INK, MARGIN_INCHES, MUTED, picture
from pipeline.geometry.least_squares import robust_sigma

NORMAL = NormalDist()
BAR = "#0072b2"
RANGE, STEP = 5.0, 0.25

COMPONENTS = {
    "corner": ["residual_x", "residual_y"],
    "highlight": ["residual_x", "residual_y"],
    "patch": ["residual_r", "residual_g", "residual_b"],
}
"""Kind of observation in residuals.parquet -> its components."""

TITLES = {"corner": "board corners", "highlight": "highlights in balls", "patch": "chart patches"}

TOP = 0.46
"""Upper end of the density's axis, the same for all: a little above the normal curve's 0.40."""

LEAST_SIGMA = 1e-9
"""Noise, in pixels or shares of full scale, that keeps perfect data from dividing by zero."""

PANEL_INCHES = (3.7, 2.5)


def normalised(residuals: pd.DataFrame, kind: str) -> Float64[np.ndarray, " components"]:
    """Residual components of one kind over their noise.

    The noise is estimated from their median length. Patches have the noise of their camera, whose response is fitted
    alone; corners and highlights have one for all.
    """
    rows = residuals[(residuals.kind == kind) & residuals[COMPONENTS[kind]].notna().all(axis=1)]
    groups = [rows] if kind != "patch" else [group for _, group in rows.groupby("camera")]
    values = [group[COMPONENTS[kind]].to_numpy(np.float64) for group in groups]
    return np.concatenate([(value / robust_sigma(value, LEAST_SIGMA)).ravel() for value in values])


def draw_histogram(path: Path, residuals: pd.DataFrame) -> None:
    """Write a PNG with one panel per kind of observation in `residuals` (residuals.parquet)."""
    kinds = [kind for kind in TITLES if (residuals.kind == kind).any()]
    width = MARGIN_INCHES + 0.1 + len(kinds) * (PANEL_INCHES[0] + GAP_INCHES) + MARGIN_INCHES
    notes = [
        "Residuals over their own noise, which is estimated from their median length.",
        "Bars should follow the curve. Fat tails: mistakes that the fit gives little weight.",
    ]
    legend = (
        Patch(color=BAR, alpha=0.75, label="found"),
        Line2D([], [], color=INK, linewidth=1.3, label="predicted: normal"),
    )
    size = (max(width, 6.8), PANEL_INCHES[1] + 0.95)
    with picture(path, size, "Residuals against their predicted spread", notes, legend) as figure:
        whole, height = figure.get_size_inches()
        for k, kind in enumerate(kinds):
            left = MARGIN_INCHES + 0.1 + k * (PANEL_INCHES[0] + GAP_INCHES)
            box = (left / whole, 0.45 / height, (PANEL_INCHES[0] - 0.2) / whole, PANEL_INCHES[1] / height)
            axes = figure.add_axes(box)
            _draw_panel(axes, kind, normalised(residuals, kind))
            axes.set_ylim(0, TOP)


def _draw_panel(axes: Axes, kind: str, values: np.ndarray) -> None:
    edges = np.arange(-RANGE, RANGE + STEP / 2, STEP)
    counts, _ = np.histogram(values, edges)
    axes.stairs(counts / (len(values) * STEP), edges, fill=True, color=BAR, alpha=0.75)
    x = np.linspace(-RANGE, RANGE, 201)
    axes.plot(x, [NORMAL.pdf(value) for value in x], color=INK, linewidth=1.3)
    axes.set(xlim=(-RANGE, RANGE), xlabel="residual / its standard deviation", yticks=[])
    axes.spines["left"].set_visible(False)
    far = float((np.abs(values) > 3).mean())
    outside = int((np.abs(values) > RANGE).sum())
    caption = {"xycoords": "axes fraction", "textcoords": "offset points"}
    axes.annotate(f"{TITLES[kind]}: {len(values)} numbers", (0, 1), (0, 17), weight="bold", **caption)
    text = f"beyond 3 sigma: {far:.1%} (normal: {2 * NORMAL.cdf(-3):.1%}); beyond {RANGE:g}: {outside} numbers"
    axes.annotate(text, (0, 1), (0, 6), size=7.5, color=MUTED, **caption)
