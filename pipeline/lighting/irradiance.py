"""Normalised irradiance per texel (RFGCA 15-16, A.1-A.3): how much of the light sent to a point arrives there.

    Irradiance(v) = sum_j L_j(v) Vis_j(v) / sum_j L_j(v),   L_j(v) = I_j / |v - x_j|^2, luminance, no cosine.

Beside the papers' map stands a second one from the same rays, with L_j max(0, n . w_j) for L_j: the share of the light
falling on a matte surface that is not shadowed. The first mixes cast shadow with the surface's own horizon; the second
is the factor that direct light on a matte surface has to be multiplied by, and where the shadow network starts.

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
    """Irradiance per texel, and what it took.

    Attributes:
        values: the papers' normalised irradiance.
        falling: the same weighted by the cosine; 0 where no light is above the horizon.
        rays: how many were traced.
        unlit: no light was on, so both are 1 by definition.
    """

    values: Float64[np.ndarray, " t"]
    falling: Float64[np.ndarray, " t"]
    rays: int
    unlit: bool


def trace_irradiance(
    occluders: Occluders,
    points: Float[np.ndarray, "t 3"],
    face_normals: Float[np.ndarray, "t 3"],
    positions: Float64[np.ndarray, "m 3"],
    luminances: Float64[np.ndarray, " m"],
    *,
    normals: Float[np.ndarray, "t 3"] | None = None,
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
        normals: of the smooth surface, for the cosine; the faces' if not given.
        samples: lights drawn per point, or None for all of them.
        sampling: probability of a light: the same for all; by luminance; by what would arrive at the point unoccluded.
        random: needed if `samples` is given.
    """
    lit = luminances > 0
    positions, luminances = positions[lit], luminances[lit]
    if not len(luminances):
        return IrradianceMap(np.ones(len(points)), np.ones(len(points)), 0, True)
    least = MIN_DISTANCE * occluders.half_extent
    normals = face_normals if normals is None else normals
    if samples is None:
        return _trace_all(occluders, points, face_normals, normals, positions, luminances, least)
    if random is None:
        raise ValueError("expected a random generator where samples are drawn, found None")
    arriving = np.stack([arriving_light(points, p, i, least) for p, i in zip(positions, luminances, strict=True)], 1)
    weights = {"uniform": np.ones_like(luminances), "power": luminances, "arriving": arriving}[sampling]
    cosines = np.stack([cosine_to(points, normals, position) for position in positions], 1)
    sums, falling, rays = np.zeros(len(points)), np.zeros(len(points)), 0
    each = np.arange(len(points))
    for n in range(samples):
        chosen, probability = draw_lights(weights, (n + random.random(len(points))) / samples)
        seen, cast = occluders.visible(points, face_normals, positions[chosen])
        estimate = np.where(seen, arriving[each, chosen] / probability, 0.0) / samples
        sums += estimate
        falling += estimate * cosines[each, chosen]
        rays += cast
    return IrradianceMap(sums / arriving.sum(1), _share(falling, (arriving * cosines).sum(1)), rays, False)


def _trace_all(
    occluders: Occluders, points: np.ndarray, face_normals: np.ndarray, normals: np.ndarray, positions: np.ndarray,
    luminances: np.ndarray, least: float,
) -> IrradianceMap:  # fmt: skip
    """Light by light: neighbouring rays then run side by side, and memory does not grow with the lights."""
    sums, rays = np.zeros((4, len(points))), 0
    for position, luminance in zip(positions, luminances, strict=True):
        light = arriving_light(points, position, luminance, least)
        seen, cast = occluders.visible(points, face_normals, position)
        falling = light * cosine_to(points, normals, position)
        sums += np.stack([light * seen, light, falling * seen, falling])
        rays += cast
    return IrradianceMap(sums[0] / sums[1], _share(sums[2], sums[3]), rays, False)


def cosine_to(
    points: Float[np.ndarray, "t 3"], normals: Float[np.ndarray, "t 3"], position: Float64[np.ndarray, " 3"]
) -> Float64[np.ndarray, " t"]:
    """max(0, n . w) at each point, w towards the light; 0 for a light on the point."""
    to_light = position - points
    distance = np.linalg.norm(to_light, axis=1)
    return np.maximum((to_light * normals).sum(1), 0.0) / np.maximum(distance, np.finfo(np.float64).tiny)


def _share(part: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """part / whole, 0 where there is nothing to have a share of."""
    return np.divide(part, whole, out=np.zeros_like(part), where=whole > 0)


def arriving_light(
    points: Float[np.ndarray, "t 3"], position: Float64[np.ndarray, " 3"], intensity: float, least_distance: float
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
