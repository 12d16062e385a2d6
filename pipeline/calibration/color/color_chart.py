"""Finding a colour chart in a linear image and measuring its patches."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64

from pipeline.base.conventions import PIXEL_CENTER
from pipeline.calibration.color.chart_layout import CLASSIC, ChartLayout

PATCH_SIDE = 0.85
"""Side of a patch over the distance from patch to patch. Gaps of 0.1 to 0.2 are sold; taking the one for the other
moves the middle of an outer patch by 0.03."""

SQUARE_SIDE = 0.45
"""Side of the square in the middle of a patch that OpenCV's detector returns, in the same units."""

DETECTION_SIDES = (1024, 640, 1600)
"""Longer sides, in pixels, at which the chart is looked for, one after the other: OpenCV's detector works on contours,
which it loses where patches are too small or too noisy."""

DETECTION_GAMMAS = (2.2, 3.0, 1.5)
"""Tone curves under which the chart is looked for: dark patches vanish in linear images."""

WHITE_PERCENTILE = 99.5
"""Brightness that is shown as white to the detector."""

LEAST_PIXELS = 16
"""Pixels in the middle of a patch below which its median is no measurement."""

SATURATED_SHARE = 0.01
"""Share of saturated pixels from which a patch is left out: its median is not yet touched, its neighbours' bloom is."""


@dataclass(frozen=True)
class Patches:
    """Patches of a chart in the order of the chart: row by row, brown first, black last.

    Attributes:
        color: median of each patch, raw linear RGB; NaN where it is not usable.
        used: large enough and not saturated.
        corners: of the square in the middle of each patch, pixels, first centre at (0.5, 0.5).
        layout: where the patches lie on the chart.
    """

    color: Float64[np.ndarray, "patches 3"]
    used: Bool[np.ndarray, " patches"]
    corners: Float64[np.ndarray, "patches 4 2"]
    layout: ChartLayout = CLASSIC

    def reordered(self, order: np.ndarray) -> Patches:
        """The same patches, patch `order[k]` first called k."""
        return Patches(self.color[order], self.used[order], self.corners[order], self.layout)

    def mirrored(self) -> bool:
        """True if the image shows the chart's rows and columns turning the other way round."""
        middles, places = self.corners.mean(1), self.layout.places
        along = np.linalg.lstsq(places - places.mean(0), middles - middles.mean(0), rcond=None)[0]
        return bool(np.linalg.det(along) < 0)


def find_chart(image: Float32[np.ndarray, "height width 3"]) -> Float64[np.ndarray, "24 4 2"] | None:
    """Squares inside the 24 patches of the classic chart in a linear image.

    Corners in pixels; None if not found.
    """
    longer = max(image.shape[:2])
    white = max(float(np.percentile(image, WHITE_PERCENTILE)), 1e-12)
    for side in DETECTION_SIDES:
        scale = side / longer
        interpolation = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
        sized = cv2.resize(image, None, fx=scale, fy=scale, interpolation=interpolation)
        for gamma in DETECTION_GAMMAS:
            shown = np.round(np.clip(sized / white, 0, 1) ** (1 / gamma) * 255).astype(np.uint8)
            detector = cv2.mcc.CCheckerDetector_create()
            detector.setColorChartType(cv2.mcc.MCC24)
            detector.setUseDnnModel(False)
            if detector.process(np.ascontiguousarray(shown[..., ::-1]), 1):
                squares = np.asarray(detector.getBestColorChecker().getColorCharts(), np.float64)
                # In our pixels, whose origin is the image's corner, sizes just divide.
                return (squares.reshape(CLASSIC.patches, 4, 2) + PIXEL_CENTER) / scale
    return None


def place_chart(
    corners: Float64[np.ndarray, "4 2"], layout: ChartLayout = CLASSIC
) -> Float64[np.ndarray, "patches 4 2"]:
    """Squares inside the patches of a chart whose four outer corners are given, pixels.

    Args:
        corners: outermost corners of the patches at the top left, top right, bottom right and bottom left: around the
            block of patches, without the chart's frame.
    """
    width, height = np.array(layout.extent) + PATCH_SIDE
    chart = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    middle = layout.places + PATCH_SIDE / 2
    around = SQUARE_SIDE / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    image_from_chart = cv2.getPerspectiveTransform(chart, corners.astype(np.float32))
    return cv2.perspectiveTransform(middle[:, None] + around, image_from_chart)


def measure_patches(
    image: Float32[np.ndarray, "height width 3"],
    saturated: Bool[np.ndarray, "height width"],
    squares: Float64[np.ndarray, "patches 4 2"],
    interior: float,
    layout: ChartLayout = CLASSIC,
) -> Patches:
    """Median colour of the middle of each square, whose side is `interior` of the square's."""
    color, used = np.full((len(squares), 3), np.nan), np.zeros(len(squares), bool)
    for k, square in enumerate(squares):
        middle = square.mean(0) + interior * (square - square.mean(0)) - PIXEL_CENTER
        mask = np.zeros(image.shape[:2], np.uint8)
        cv2.fillConvexPoly(mask, np.round(middle).astype(np.int32), 1)
        inside = mask > 0
        if inside.sum() >= LEAST_PIXELS and saturated[inside].mean() < SATURATED_SHARE:
            color[k], used[k] = np.median(image[inside], axis=0), True
    return Patches(color, used, squares, layout)
