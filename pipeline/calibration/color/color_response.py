"""Fit of each camera's 3 x 3 colour response to what it sees of a chart.

All cameras are brought to their average.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from pipeline.calibration.color.color_chart import Patches
from pipeline.geometry.least_squares import solve_least_squares

LEAST_SIGMA = 1e-5
"""Noise that no patch is better than, as a share of full scale."""


@dataclass(frozen=True)
class Response:
    """raw = matrix @ patch value, the light on the chart included.

    Attributes:
        sigma: standard deviation of each entry of the matrix.
        patches: in the order that fits the chart's values.
        residual: raw minus fitted, NaN where unused.
        weight: of each patch in the robust fit, 1 = fully counted.
    """

    matrix: Float64[np.ndarray, "3 3"]
    sigma: Float64[np.ndarray, "3 3"]
    patches: Patches
    residual: Float64[np.ndarray, "patches 3"]
    weight: Float64[np.ndarray, " patches"]

    def relative_residual(self) -> Float64[np.ndarray, " patches"]:
        """Residual of each patch, over the brightest patch; NaN where unused.

        Root mean square over the channels.
        """
        return np.sqrt((self.residual**2).mean(1)) / np.nanmax(self.patches.color)

    def odd(self, largest: float) -> Bool[np.ndarray, " patches"]:
        """Patches in use whose relative residual is larger: they show something else."""
        return np.nan_to_num(self.relative_residual()) > largest

    def relative_sigma(self) -> float:
        """Standard deviation of the matrix's least certain entry.

        Over the gain of an average channel.
        """
        return float(self.sigma.max() / (np.linalg.norm(self.matrix) / np.sqrt(3)))


def fit_response(patches: Patches, values: Float64[np.ndarray, "patches 3"]) -> Response:
    """Least squares with Cauchy's loss, so that one dirty patch does not tint the camera.

    The chart is tried in all orders that its outline allows; the best fit is kept.
    """
    fits = [_fit(patches.reordered(order), values) for order in patches.layout.orders]
    return min(fits, key=lambda fit: np.nanmedian(np.linalg.norm(fit.residual, axis=1)))


def _fit(patches: Patches, values: np.ndarray) -> Response:
    design, measured = values[patches.used], patches.color[patches.used]
    jacobian = np.kron(design, np.eye(3))  # of row-major residuals by the columns of the matrix, one after the other
    start = np.linalg.lstsq(design, measured, rcond=None)[0]
    solution = solve_least_squares(
        lambda x: (design @ x.reshape(3, 3) - measured, jacobian), start.ravel(), LEAST_SIGMA
    )  # fmt: skip
    residual, weight = np.full(values.shape, np.nan), np.zeros(len(values))
    residual[patches.used], weight[patches.used] = -solution.residual, solution.weight
    sigma = np.sqrt(np.diag(solution.covariance)).reshape(3, 3).T
    return Response(solution.parameters.reshape(3, 3).T, sigma, patches, residual, weight)


def corrections(responses: Mapping[str, Float64[np.ndarray, "3 3"]]) -> dict[str, Float64[np.ndarray, "3 3"]]:
    """corrected_from_raw of every camera.

    To the average camera, whose response is the mean of all.
    """
    average = np.mean(list(responses.values()), axis=0)
    return {name: average @ np.linalg.inv(response) for name, response in responses.items()}
