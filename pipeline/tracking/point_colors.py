"""Colours of points on a moving surface, from all cameras and frames that see them.

A camera c sees the matte point p in frame f as ``M_c A_p (s_pf + a s)``: A its albedo, s_pf the direct light on it
(`pipeline.lighting.direct_light`), s that light's median, a the share that light bounced off the subject and its
surroundings adds, and M the camera's 3 x 3 colour response. A and M are found in turns by reweighted least squares
(Cauchy's loss), whose weights leave out highlights and points that are not where they are believed to be.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from pipeline.geometry.least_squares import CAUCHY

AMBIENT = 0.1
"""a of the module's docstring. Its value hardly matters where all lights are on: it keeps a point that is in all
lights' shadow from being taken for white."""

TURNS = 5
"""Turns of albedo and response; the responses start at the identity, from which they are a few percent away."""

RESPONSE_WEIGHT = 1e-3
"""Of the identity against a camera's own measurements, relative to the trace of its normal matrix: decides for a
colour that the subject does not have."""

MEDIAN_LENGTH = 1.5381722544550522
"""Median length of a vector of three standard normal coordinates."""


@dataclass(frozen=True)
class PointColors:
    """Factors of the colours of points: each is `responses` @ albedo * `shading`.

    Attributes:
        albedo: of each point.
        shading: light on each point in each frame, bounced light included.
        responses: of each camera.
        weight: robust precision of each observation, 0 where a point is not seen.
    """

    albedo: Float64[np.ndarray, "points 3"]
    shading: Float64[np.ndarray, "frames points"]
    responses: Float64[np.ndarray, "cameras 3 3"]
    weight: Float64[np.ndarray, "cameras frames points"]


def fit_point_colors(
    observed: Float64[np.ndarray, "cameras frames points 3"],
    seen: Bool[np.ndarray, "cameras frames points"],
    light: Float64[np.ndarray, "frames points"],
) -> PointColors:
    """Fit albedo and camera responses to the colours `observed` where `seen`, under `light`."""
    shading = light + AMBIENT * np.median(light, axis=1, keepdims=True)
    responses = np.tile(np.eye(3), (len(observed), 1, 1))
    weight = seen.astype(np.float64)
    for _ in range(TURNS):
        plain = np.einsum("cij,cfpj->cfpi", np.linalg.inv(responses), observed, optimize=True)
        sums = np.einsum("cfp,fp,cfpi->pi", weight, shading, plain, optimize=True)
        albedo = sums / np.maximum(np.einsum("cfp,fp->p", weight, shading**2), np.finfo(float).tiny)[:, None]
        lit = albedo * shading[..., None]
        for camera, rows in enumerate(seen):
            if rows.any():
                responses[camera] = _response(lit[rows], observed[camera][rows], weight[camera][rows])
        predicted = np.einsum("cij,fpj->cfpi", responses, lit, optimize=True)
        length = np.linalg.norm(observed - predicted, axis=-1)
        sigma = max(float(np.median(length[seen])) / MEDIAN_LENGTH, np.finfo(np.float32).tiny) if seen.any() else 1.0
        weight = seen / (1 + (length / (CAUCHY * sigma)) ** 2)
    return PointColors(albedo, shading, responses, weight / sigma**2)


def _response(lit: np.ndarray, observed: np.ndarray, weight: np.ndarray) -> Float64[np.ndarray, "3 3"]:
    """M with observed = M lit, weighted, held near the identity."""
    normal = (lit * weight[:, None]).T @ lit
    hold = RESPONSE_WEIGHT * np.trace(normal) * np.eye(3) + np.finfo(float).tiny * np.eye(3)
    return np.linalg.solve(normal + hold, (lit * weight[:, None]).T @ observed + hold).T
