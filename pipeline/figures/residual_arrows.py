"""Residuals of the fit in each camera's image, as magnified arrows.

A pattern in them means that a model is off.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.colors import Normalize

from pipeline.base.verdicts import Grade
from pipeline.figures.style import (
    BAR_INCHES,
    INK,
    add_color_bar,
    add_panels,
    frame_panel,
    grid_size,
    picture,
    rms,
    round_factor,
)
from pipeline.geometry.cameras import Camera

PANEL_INCHES = 2.4
MAP = "cividis_r"

ARROW_SHARE = 0.12
"""Length at most, over the image's longer side, of an arrow that nine of ten do not exceed."""


def draw_residuals(
    path: Path, corners: pd.DataFrame, cameras: Mapping[str, Camera], names: Sequence[str], grades: Mapping[str, Grade],
    which: str,
) -> None:  # fmt: skip
    """Write a PNG with one panel per camera of `names`.

    Arrows point from detected to projected corners.

    Args:
        corners: columns camera, x, y, residual_x, residual_y, weight: residuals_cameras.parquet.
        grades: of the cameras.
        which: the cameras in words, for the header.
    """
    rows = {name: table for name, table in corners.groupby("camera") if name in names}
    factor = magnification(pd.concat(rows.values()), max(cameras[name].width for name in names))
    tallest = max(cameras[name].height / cameras[name].width for name in names)
    panel = (PANEL_INCHES, PANEL_INCHES * min(tallest, 1.4))
    size, columns = grid_size(len(names), panel)
    key_px = round_length(ARROW_SHARE * max(cameras[name].width for name in names) / factor)
    notes = [
        f"From detected to projected corners, magnified {factor:g} times; {which}.",
        "Arrows should point anywhere. Neighbours that agree: a wrong lens model, or the camera moved.",
    ]
    with picture(path, (size[0], size[1] + BAR_INCHES), "Corner residuals", notes) as figure:
        for axes, name in zip(add_panels(figure, len(names), panel, columns), names, strict=True):
            x, y, dx, dy = (rows[name][key] for key in ("x", "y", "residual_x", "residual_y"))
            arrows = axes.quiver(
                x, y, factor * dx, factor * dy, rows[name].weight, cmap=MAP, norm=Normalize(0, 1), angles="xy",
                scale_units="xy", scale=1, width=0.005, headwidth=3, headlength=3.5,
                headaxislength=3, minlength=0,
            )  # fmt: skip
            axes.set(xlim=(0, cameras[name].width), ylim=(cameras[name].height, 0), aspect="equal")
            length = rms(np.stack([dx, dy], 1))
            frame_panel(axes, name, f"{len(x)} corners, {length:.3f} px RMS", grades.get(name, "good"))
        add_color_bar(figure, Normalize(0, 1), MAP, "weight in the fit: 0 = ignored, 1 = fully counted")
        width, height = figure.get_size_inches()
        axes.quiverkey(
            arrows, 6.4 / width, 0.325 / height, factor * key_px, f"{key_px:g} px", labelpos="E",
            coordinates="figure", color=INK,
        )  # fmt: skip


def magnification(corners: pd.DataFrame, width_px: int) -> float:
    """The round factor that makes long arrows `ARROW_SHARE` of the image's width, at most."""
    length = np.hypot(corners.residual_x, corners.residual_y)
    return round_factor(ARROW_SHARE * width_px / max(float(np.percentile(length, 90)), 1e-9))


def round_length(length_px: float) -> float:
    """A length of one digit, 1, 2 or 5, up to `length_px`, which may be below one."""
    power = 10.0 ** np.floor(np.log10(length_px))
    return float(f"{power * round_factor(length_px / power):g}")
