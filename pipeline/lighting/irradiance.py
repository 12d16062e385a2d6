"""Normalised irradiance per texel (RFGCA 15-16, A.1-A.3): how much of the light sent to a point arrives there.

    Irradiance(v) = sum_j L_j(v) Vis_j(v) / sum_j L_j(v),   L_j(v) = I_j / |v - x_j|^2, luminance, no cosine.

The denominator needs no rays and is always exact. The numerator is summed over all lights, or estimated from N of them
drawn with probability p_j: (1/N) sum L_j Vis_j / p_j, unbiased; single estimates may exceed 1. The draws are stratified
(the n-th lies in the n-th of N equal parts of the cumulative distribution), which keeps the mean and lowers the
variance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, Float64, Int

from pipeline.lighting.visibility import Occluders

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Luminance of linear RGB with Rec. 709 primaries (ITU-R BT.709, item 3.2)."""

MIN_DISTANCE = 1e-6
"""Least distance to a light, relative to the scene's half extent: a light on the surface is finite, and outshines all
others there all the same."""

Sampling = Literal["uniform", "power", "arriving"]


@dataclass(frozen=True)
class IrradianceMap:
    """Irradiance per texel, and what it took. `unlit`: no light was on, so the irradiance is 1 by definition."""

    values: Float64[np.ndarray, " t"]
    rays: int
    unlit: bool


def trace_irradiance(
    occluders: Occluders,
    points: Float[np.ndarray, "t 3"],
    face_normals: Float[np.ndarray, "t 3"],
    positions: Float64[np.ndarray, "m 3"],
    luminances: Float64[np.ndarray, " m"],
    *,
    samples: int | None = None,
    sampling: Sampling = "power",
    random: np.random.Generator | None = None,
) -> IrradianceMap:
    """Irradiance of every point under point lights; see the module's docstring.

    Args:
        occluders: the posed mesh.
        points: on the mesh; `face_normals`: geometric, outward, unit length.
        positions: of the lights, in the unit of the points.
        luminances: of the lights' radiant intensities, not negative; lights at zero are off and cost nothing.
        samples: lights drawn per point, or None for all of them.
        sampling: probability of a light: the same for all; by luminance; by what would arrive at the point unoccluded.
        random: needed if `samples` is given.
    """
    lit = luminances > 0
    positions, luminances = positions[lit], luminances[lit]
    if not len(luminances):
        return IrradianceMap(np.ones(len(points)), 0, True)
    least = MIN_DISTANCE * occluders.half_extent
    if samples is None:
        return _trace_all(occluders, points, face_normals, positions, luminances, least)
    if random is None:
        raise ValueError("expected a random generator where samples are drawn, found None")
    arriving = np.stack([arriving_light(points, p, i, least) for p, i in zip(positions, luminances, strict=True)], 1)
    weights = {"uniform": np.ones_like(luminances), "power": luminances, "arriving": arriving}[sampling]
    total, sums, rays = arriving.sum(1), np.zeros(len(points)), 0
    each = np.arange(len(points))
    for n in range(samples):
        chosen, probability = draw_lights(weights, (n + random.random(len(points))) / samples)
        seen, cast = occluders.visible(points, face_normals, positions[chosen])
        sums += np.where(seen, arriving[each, chosen] / probability, 0.0)
        rays += cast
    return IrradianceMap(sums / samples / total, rays, False)


def _trace_all(
    occluders: Occluders, points: np.ndarray, face_normals: np.ndarray, positions: np.ndarray, luminances: np.ndarray,
    least: float,
) -> IrradianceMap:  # fmt: skip
    """Light by light: neighbouring rays then run side by side, and memory does not grow with the lights."""
    arrived, sent, rays = np.zeros(len(points)), np.zeros(len(points)), 0
    for position, luminance in zip(positions, luminances, strict=True):
        light = arriving_light(points, position, luminance, least)
        seen, cast = occluders.visible(points, face_normals, position)
        sent += light
        arrived += np.where(seen, light, 0.0)
        rays += cast
    return IrradianceMap(arrived / sent, rays, False)


def arriving_light(
    points: Float[np.ndarray, "t 3"], position: Float64[np.ndarray, 3], intensity: float, least_distance: float
) -> Float64[np.ndarray, " t"]:
    """I / d^2 at each point, before any cosine or shadow; distances below `least_distance` count as that."""
    squared = ((points - position) ** 2).sum(1)
    return intensity / np.maximum(squared, least_distance**2)


def draw_lights(
    weights: Float64[np.ndarray, " m"] | Float64[np.ndarray, "t m"], uniform: Float64[np.ndarray, " t"]
) -> tuple[Int[np.ndarray, " t"], Float64[np.ndarray, " t"]]:
    """One light per point with probability proportional to its weight, by inversion, and that probability.

    Args:
        weights: not negative, per light, or per point and light.
        uniform: numbers in [0, 1), one per point.
    """
    cumulative = np.cumsum(weights, -1)
    target = uniform * cumulative[..., -1]
    if weights.ndim == 1:
        chosen = np.searchsorted(cumulative, target, side="right")
    else:
        chosen = (cumulative <= target[:, None]).sum(1)
    # Rounding may carry `target` up to the very end of the distribution.
    chosen = np.minimum(chosen, weights.shape[-1] - 1)
    drawn = weights[chosen] if weights.ndim == 1 else weights[np.arange(len(chosen)), chosen]
    return chosen, drawn / cumulative[..., -1]
