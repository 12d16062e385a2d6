"""Relative brightness of lights, from their mirror images in balls.

A mirror keeps radiance (Nicodemus 1963), so a small light of radiant intensity I shows with its own radiance on an area
of the image that is `LocatedLights.spread` times its own, square to its way to the ball: the pixels of a highlight add
up to I x spread, times the ball's reflectance and the camera's exposure. For a far camera the spread is (radius / 2)^2
over the squared distance, whatever the direction: a mirror ball maps solid angles to areas evenly. What the ball and a
camera do to all lights alike is fitted away, so intensities are relative; pixels are taken to be proportional to
radiance everywhere in the image, and the ball to be as shiny near its rim as in its middle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse
from jaxtyping import Float64, Int64

from pipeline.geometry.least_squares import solve_least_squares

LEAST_SIGMA = 1e-3
"""Logarithms of brightness are never better known than this: a quarter of a grey level in 256."""

GAIN_SIGMA = 10.0
"""Prior of the logarithm of a camera's gain: wide enough for any exposure, and it says where the zero is."""


@dataclass(frozen=True)
class Brightness:
    """Per light and channel, NaN where there is nothing to measure.

    Attributes:
        value: over the geometric mean of all lights that are measured.
        sigma: standard deviation of `value`, from how well images agree.
    """

    value: Float64[np.ndarray, "lights channels"]
    sigma: Float64[np.ndarray, "lights channels"]


def compare_lights(
    light: Int64[np.ndarray, " highlights"],
    camera: Int64[np.ndarray, " highlights"],
    flux: Float64[np.ndarray, "highlights channels"],
    spread: Float64[np.ndarray, " highlights"],
    lights: int,
) -> Brightness:
    """Relative brightness of lights and cameras, fitted robustly for each channel.

    log(flux / spread) = log(light) + log(camera).
    """
    usable = (flux > 0).all(1) & (spread > 0)
    light, camera = light[usable], camera[usable]
    value, sigma = np.full((2, lights, flux.shape[1]), np.nan)
    seen, row = np.unique(light, return_inverse=True)
    eyes, eye = np.unique(camera, return_inverse=True)
    if not len(seen):
        return Brightness(value, sigma)
    count = len(seen) + len(eyes)
    at = np.arange(len(row))
    rows, columns = np.concatenate([at, at]), np.concatenate([row, len(seen) + eye])
    matrix = scipy.sparse.csr_array((np.ones(2 * len(row)), (rows, columns)), shape=(len(row), count))
    prior_sigma = np.concatenate([np.full(len(seen), np.inf), np.full(len(eyes), GAIN_SIGMA)])
    centered = np.eye(len(seen)) - 1 / len(seen)
    for channel, measured in enumerate(np.log(flux[usable] / spread[usable, None]).T):
        start = np.concatenate([np.full(len(seen), np.median(measured)), np.zeros(len(eyes))])
        solution = solve_least_squares(
            lambda x, measured=measured: ((matrix @ x - measured)[:, None], matrix),
            start, LEAST_SIGMA, np.zeros(count), prior_sigma,
        )  # fmt: skip
        covariance = centered @ solution.covariance[: len(seen), : len(seen)] @ centered
        value[seen, channel] = np.exp(centered @ solution.parameters[: len(seen)])
        # As many unknowns as numbers agree perfectly, which says nothing.
        if len(row) > count - 1:
            sigma[seen, channel] = value[seen, channel] * np.sqrt(np.diag(covariance))
    return Brightness(value, sigma)


def relative_colors(brightness: Brightness) -> Brightness:
    """Each light's channels over their mean: 1, 1, 1 is the colour of the average light."""
    value, total = brightness.value, brightness.value.sum(1, keepdims=True)
    share, relative = value / total, brightness.sigma / value
    squares = (share * relative) ** 2
    # d log(color_c) = (1 - share_c) d log(value_c) - sum over the others of share_k d log(value_k)
    spread = ((1 - share) * relative) ** 2 + squares.sum(1, keepdims=True) - squares
    color = value.shape[1] * share
    return Brightness(color, color * np.sqrt(spread))
