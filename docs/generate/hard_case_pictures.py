"""Draw ten of the hard cases, one picture each: ours, the naive formula, and the truth.

    python -m docs.generate.hard_case_pictures

Writes docs/pictures/hard_cases/NAME.png, which docs/reliability.md shows.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import matplotlib
import numpy as np
import tyro
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from docs.generate.hard_case_curves import Curves
from docs.generate.hard_case_geometry import fold_of_a_lens, half_turn, shadow_rays, sliver, small_turn
from docs.generate.hard_case_shading import (
    black_in_srgb,
    light_on_the_surface,
    narrow_highlight,
    needle,
    slope_of_a_glint,
)
from pipeline.base.code_digest import ROOT
from pipeline.base.files import written_whole
from pipeline.figures.style import FAINT, MUTED, RC

FOLDER = ROOT / "docs/pictures/hard_cases"

CURVES: dict[str, Callable[[], Curves]] = {
    function.__name__: function
    for function in (
        narrow_highlight, slope_of_a_glint, light_on_the_surface, shadow_rays, needle, black_in_srgb, sliver,
        fold_of_a_lens, small_turn, half_turn,
    )
}  # fmt: skip
"""Name of the picture -> what gives its curves."""

INCHES, DPI = (4.0, 2.6), 110

TRUTH, OURS, NAIVE = "#b9bec6", "#0072b2", "#d55e00"
"""Colours of the curves, told apart by colour-blind eyes; the truth is broad, so that ours is seen on it."""


def run(*, names: tuple[str, ...] = tuple(CURVES), out: Path = FOLDER) -> None:
    """Write pictures.

    Args:
        names: which of them.
        out: folder for NAME.png.
    """
    out.mkdir(parents=True, exist_ok=True)
    for name in names:
        draw(CURVES[name](), out / f"{name}.png")
        print(f"{out / name}.png: {(out / f'{name}.png').stat().st_size / 1e3:.0f} kB")


def draw(curves: Curves, path: Path) -> None:
    """Write one picture as PNG."""
    with matplotlib.rc_context(RC):
        figure = Figure(figsize=INCHES, dpi=DPI, facecolor="white", layout="constrained")
        axes = figure.add_subplot(xscale=curves.scales[0], yscale=curves.scales[1])
        axes.set_title(curves.title, size=10, weight="bold", loc="left")
        axes.set(xlabel=curves.across, ylabel=curves.up, xlim=(curves.at[0], curves.at[-1]), ylim=curves.shown)
        axes.plot(curves.at, curves.truth, color=TRUTH, linewidth=6, solid_capstyle="butt", label="truth")
        axes.plot(curves.at, curves.naive, color=NAIVE, linewidth=1.1, marker=".", markersize=3, label="naive")
        axes.plot(curves.at, curves.ours, color=OURS, linewidth=1.3, label="ours")
        mark_missing(axes, curves)
        axes.grid(color=FAINT, linewidth=0.5)
        axes.set_axisbelow(True)
        axes.tick_params(colors=MUTED, labelsize=7.5)
        figure.legend(loc="outside lower center", ncols=4, fontsize=7.5, handlelength=1.6, columnspacing=1.2)
        with written_whole(path) as temporary:
            figure.savefig(temporary, format="png", metadata={"Software": None})


def mark_missing(axes: Axes, curves: Curves) -> None:
    """Crosses along the lower edge where the naive formula gives no number."""
    missing = curves.at[~np.isfinite(curves.naive)]
    if len(missing):
        crosses = {"marker": "x", "markersize": 3.5, "color": NAIVE, "linestyle": "none", "clip_on": False}
        axes.plot(missing, np.zeros(len(missing)), transform=axes.get_xaxis_transform(), **crosses,
                  label="naive: no number")  # fmt: skip


if __name__ == "__main__":
    tyro.cli(run)
