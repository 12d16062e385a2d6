"""Finding a 24-patch colour chart in a linear image, measuring its patches, and fitting a camera's response to them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64

from pipeline.geometry.least_squares import solve_least_squares

PATCHES = 24

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

LEAST_SIGMA = 1e-5
"""Noise that no patch is better than, as a share of full scale."""


@dataclass(frozen=True)
class Patches:
    """Patches of a chart in the order of the chart: row by row, brown first, black last.

    Attributes:
        color: median of each patch, raw linear RGB; NaN where it is not usable.
        used: large enough and not saturated.
    """

    color: Float64[np.ndarray, "24 3"]
    used: Bool[np.ndarray, " 24"]


def find_chart(image: Float32[np.ndarray, "height width 3"]) -> Float64[np.ndarray, "24 4 2"] | None:
    """Squares inside the 24 patches of the chart in a linear image: corners in OpenCV's pixels; None if not found."""
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
                # Pixel centres move under scaling: (x + 0.5) / scale - 0.5.
                return (squares.reshape(PATCHES, 4, 2) + 0.5) / scale - 0.5
    return None


def measure_patches(
    image: Float32[np.ndarray, "height width 3"],
    squares: Float64[np.ndarray, "24 4 2"],
    interior: float,
    saturation: float,
) -> Patches:
    """Median colour of the middle of each square, whose side is `interior` of the square's."""
    color, used = np.full((PATCHES, 3), np.nan), np.zeros(PATCHES, bool)
    for k, square in enumerate(squares):
        middle = square.mean(0) + interior * (square - square.mean(0))
        mask = np.zeros(image.shape[:2], np.uint8)
        cv2.fillConvexPoly(mask, np.round(middle).astype(np.int32), 1)
        pixels = image[mask > 0]
        if len(pixels) >= LEAST_PIXELS and (pixels >= saturation).any(1).mean() < SATURATED_SHARE:
            color[k], used[k] = np.median(pixels, axis=0), True
    return Patches(color, used)


@dataclass(frozen=True)
class Response:
    """raw = matrix @ patch value, light included. Residual (NaN where unused): raw minus fitted, robust weights."""

    matrix: Float64[np.ndarray, "3 3"]
    patches: Patches
    residual: Float64[np.ndarray, "24 3"]
    weight: Float64[np.ndarray, " 24"]


def fit_response(patches: Patches, values: Float64[np.ndarray, "24 3"]) -> Response:
    """Least squares with Cauchy's loss, so that one dirty patch does not tint the camera.

    The chart is tried both ways up (the detector may find it upside down); the better fit is kept.
    """
    fits = [_fit(Patches(patches.color[order], patches.used[order]), values) for order in (np.s_[:], np.s_[::-1])]
    return min(fits, key=lambda fit: np.nanmedian(np.linalg.norm(fit.residual, axis=1)))


def _fit(patches: Patches, values: np.ndarray) -> Response:
    design, measured = values[patches.used], patches.color[patches.used]
    jacobian = np.kron(design, np.eye(3))  # of row-major residuals by the columns of the matrix, one after the other
    start = np.linalg.lstsq(design, measured, rcond=None)[0]
    solution = solve_least_squares(
        lambda x: (design @ x.reshape(3, 3) - measured, jacobian), start.ravel(), LEAST_SIGMA
    )  # fmt: skip
    matrix = solution.parameters.reshape(3, 3).T
    residual, weight = np.full((PATCHES, 3), np.nan), np.zeros(PATCHES)
    residual[patches.used], weight[patches.used] = -solution.residual, solution.weight
    return Response(matrix, patches, residual, weight)


def corrections(responses: dict[str, Float64[np.ndarray, "3 3"]]) -> dict[str, Float64[np.ndarray, "3 3"]]:
    """corrected_from_raw of every camera: to the average camera, whose response is the mean of all."""
    average = np.mean(list(responses.values()), axis=0)
    return {name: average @ np.linalg.inv(response) for name, response in responses.items()}
