"""Colour charts before and after correction.

The colours that the average camera sees are set into the patches.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import skimage.color
from jaxtyping import Float32, Float64
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from pipeline.base.color import srgb_from_linear
from pipeline.base.conventions import PIXEL_CENTER
from pipeline.base.verdicts import Grade
from pipeline.calibration.color.chart_layout import CLASSIC, ChartLayout
from pipeline.figures.style import INK, add_panels, frame_panel, grid_size, picture

CELL_PX, OVERSAMPLING = 16, 4
"""Pixels per patch in the picture, and times that it is sampled finer.

Enough pixels for glare and stains to show.
"""

PANEL_INCHES = (3.04, 0.994)
"""Two charts and the gap between them: the proportions of what `_draw_pair` draws."""

INSET = 0.36
"""Side of the inset colour over the distance of two patches."""

WHITE_PATCH, WHITE_LEVEL = 18, 0.9
"""The white patch, from 0, and the linear level at which it is shown: its true reflectance."""


@dataclass(frozen=True)
class Chart:
    """One camera's chart.

    Attributes:
        raw: the chart upright, brown patch first, black patch last; linear, as the camera recorded it.
        color: median of each patch, as recorded; NaN where unusable.
        correction: corrected-from-raw.
        layout: where the patches lie.
    """

    camera: str
    raw: Float32[np.ndarray, "height width 3"]
    color: Float64[np.ndarray, "patches 3"]
    correction: Float64[np.ndarray, "3 3"]
    layout: ChartLayout = CLASSIC


def upright(
    image: Float32[np.ndarray, "h w 3"], centers: Float64[np.ndarray, "patches 2"], layout: ChartLayout = CLASSIC
) -> Float32[np.ndarray, "H W 3"]:
    """The chart as square cells of `CELL_PX`, noise averaged.

    Each patch lies in the middle of its cell.

    Args:
        centers: of the patches, pixels; first pixel centre at (0.5, 0.5).
    """
    cells = (layout.places + 0.5) * CELL_PX * OVERSAMPLING
    # OpenCV counts from pixel centres, here as there.
    homography, _ = cv2.findHomography(centers - PIXEL_CENTER, cells - PIXEL_CENTER)
    size = _size_px(layout)
    fine = cv2.warpPerspective(image, homography, (size[0] * OVERSAMPLING, size[1] * OVERSAMPLING))
    return cv2.resize(fine, size, interpolation=cv2.INTER_AREA)


def _size_px(layout: ChartLayout) -> tuple[int, int]:
    """Width and height of an upright chart."""
    columns, rows = layout.extent
    return round((columns + 1) * CELL_PX), round((rows + 1) * CELL_PX)


def average_colors(residuals: pd.DataFrame, corrections: Mapping[str, np.ndarray]) -> Float64[np.ndarray, "patches 3"]:
    """Colour of each patch for the average camera.

    From each camera's fitted colours (residuals_color.parquet): fitted = M_c value and corrected_from_raw_c = mean(M)
    M_c^-1, so that corrected fitted colours are mean(M) value for every camera; the median is over cameras that could
    measure a patch, NaN where none could.
    """
    raw, residual = (residuals[[f"{prefix}{c}" for c in "rgb"]].to_numpy(np.float64) for prefix in ("", "residual_"))
    matrices = np.stack([corrections[camera] for camera in residuals.camera])
    corrected = pd.DataFrame(np.einsum("nij,nj->ni", matrices, raw - residual))
    medians = corrected.groupby(residuals.patch.to_numpy()).median()
    return medians.reindex(range(1, int(residuals.patch.max()) + 1)).to_numpy(np.float64)


def display(linear: np.ndarray, white: float) -> np.ndarray:
    """Linear colours as sRGB in [0, 1], `white` shown as `WHITE_LEVEL`."""
    return srgb_from_linear(np.clip(linear * (WHITE_LEVEL / white), 0, 1))


def white_level(target: Float64[np.ndarray, "patches 3"]) -> float:
    """Linear level of the white patch's brightest channel.

    If no camera measured the white patch, or the chart is not the classic one, it is the brightest patch's.
    """
    classic = len(target) == CLASSIC.patches and np.isfinite(target[WHITE_PATCH]).all()
    return float(np.nanmax(target[WHITE_PATCH] if classic else target))


def difference(color: Float64[np.ndarray, "patches 3"], target: Float64[np.ndarray, "patches 3"]) -> float:
    """Mean CIEDE2000 over the patches that are measured in both.

    `target` is white where its white patch is.
    """
    white = white_level(target)
    usable = np.isfinite(color).all(1) & np.isfinite(target).all(1)
    lab = [skimage.color.rgb2lab(display(colors[usable], white)) for colors in (color, target)]
    return float(skimage.color.deltaE_ciede2000(*lab).mean())


def draw_charts(
    path: Path, charts: list[Chart], target: Float64[np.ndarray, "patches 3"], grades: Mapping[str, Grade], which: str
) -> None:
    """Write a PNG with one panel per camera: its chart as recorded, and corrected.

    The recorded chart is on the left.

    Args:
        target: colours of the average camera, set into each patch.
        grades: of the cameras' colour.
        which: the cameras in words, for the header.
    """
    size, columns = grid_size(len(charts), PANEL_INCHES)
    notes = [
        f"Left: as recorded; right: corrected to the average camera, whose colours are set in; {which}.",
        "Right, the insets should vanish. Delta E (CIEDE2000) below 1 is invisible, above 5 obvious.",
    ]
    with picture(path, size, "Colour charts", notes) as figure:
        for axes, chart in zip(add_panels(figure, len(charts), PANEL_INCHES, columns), charts, strict=True):
            corrected = chart.color @ chart.correction.T
            _draw_pair(axes, chart, target, white_level(target))
            before, after = (difference(color, target) for color in (chart.color, corrected))
            detail = f"mean Delta E {before:.2f} before, {after:.2f} after"
            frame_panel(axes, chart.camera, detail, grades.get(chart.camera, "good"))


def _draw_pair(axes: Axes, chart: Chart, target: np.ndarray, white: float) -> None:
    gap = CELL_PX // 4
    width, height = _size_px(chart.layout)
    for image, left in ((chart.raw, 0), (chart.raw @ chart.correction.T, width + gap)):
        axes.imshow(display(image, white), extent=(left, left + width, height, 0), interpolation="nearest")
        for k, color in enumerate(display(target, white)):
            if np.isfinite(color).all():
                x, y = (chart.layout.places[k] + 0.5 - INSET / 2) * CELL_PX
                axes.add_patch(Rectangle((left + x, y), INSET * CELL_PX, INSET * CELL_PX, color=color, linewidth=0))
    axes.set(xlim=(0, 2 * width + gap), ylim=(height, 0), facecolor="white")
    axes.axvline(width + gap / 2, color=INK, linewidth=0.6)
