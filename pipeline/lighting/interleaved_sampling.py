"""Irradiance from few shadow rays per texel, to which each texel's neighbours lend theirs.

A texel that draws one of m lights learns of that one alone, but its neighbours have drawn the others, and what stands
in a light's way mostly stands in their way, too (interleaved sampling, Keller and Heidrich 2001). So only this is taken
from the neighbours: the share V_j of rays to light j that met nothing. What can be computed without a ray, the light's
strength, the cosine and the texel's own horizon, is the texel's own, summed over all lights:

    Irradiance = sum_j L_j V_j / sum_j L_j   with V_j = 0 below the horizon, above it as the neighbours say.

Lights that no neighbour drew are made up for by those that one did: light j is weighted by 1 / P_j, P_j = 1 - (1 -
p_j)^n the chance that one of n draws is j (a ratio of two estimators of Horvitz and Thompson 1952). If each light is
drawn many times nothing is left to chance but V_j; if there are far more lights than draws this is the usual L / p.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float64, Int32

from pipeline.geometry.texels import Atlas
from pipeline.lighting.interleaved_kernels import BELOW_HORIZON, BLOCKED, CLEAR, gather
from pipeline.lighting.irradiance import IrradianceMap, Samples, draw_lights
from pipeline.lighting.light_sampling import pattern_numbers
from pipeline.lighting.light_scene import Scene

REACH = 0.5
"""Standard deviation of the neighbours' weights, in mean distances between draws of the same light: of 6 to 64 lights
on a recorded body the maps came nearest to the exact ones at 0.4 to 0.6."""

LEAST_TEXELS, MOST_TEXELS = 0.6, 2.0
"""Bounds of that deviation, in texels: next neighbours are always asked; beyond 89 of them it takes longer than it
saves in rays."""

EDGE = 2.5
"""Deviations at which the weights are cut off: a twentieth of the largest."""

ALMOST_SURE = 1 - 1e-12
"""Stands for a probability of 1, whose logarithm of missing is infinite."""


class Neighbours:
    """Texels around each texel of an atlas, in its own chart: the same for all frames."""

    def __init__(self, atlas: Atlas) -> None:
        self.texel, self.chart = atlas.texel.astype(np.int32), atlas.chart.astype(np.int32)
        self.number = np.full((atlas.size, atlas.size), -1, np.int32)
        self.number[self.texel[:, 0], self.texel[:, 1]] = np.arange(atlas.texel_count)

    def window(self, deviation: float) -> tuple[Int32[np.ndarray, "w 2"], Float64[np.ndarray, " w"]]:
        """Steps to the neighbours that are asked, and their weights, for a deviation in texels."""
        far = math.ceil(EDGE * deviation)
        steps = np.mgrid[-far : far + 1, -far : far + 1].reshape(2, -1).T
        squared = (steps**2).sum(1) / deviation**2
        near = squared <= EDGE**2
        return steps[near].astype(np.int32), np.exp(-0.5 * squared[near])


def lights_that_count(scene: Scene, samples: Samples) -> tuple[Float64[np.ndarray, " m"], float]:
    """Probability of each light, and the number of equal lights that vary as much. Both are the same for all texels."""
    probability = scene.chances(samples.sampling)
    return probability, 1 / float((probability**2).sum())


def share_rays(scene: Scene, samples: Samples, neighbours: Neighbours) -> IrradianceMap:
    """Irradiance of every texel from the rays of `samples` and of its neighbours.

    `error` is what chance leaves of independent draws: which lights were drawn, and how often each was found blocked.
    That a shadow's edge lies elsewhere for a neighbour is not in it. Needs 5 bytes per texel and draw.

    Args:
        scene: the texels of `neighbours`, in their order, and their lights.
        samples: how lights are drawn.
    """
    texels, count = len(scene.receivers), samples.count
    chosen, state = np.empty((count, texels), np.int32), np.full((count, texels), BELOW_HORIZON, np.uint8)
    per_arriving = scene.per_arriving()[0] if samples.sampling == "arriving" else None
    rays = 0
    for n in range(count):
        uniform = (n + pattern_numbers(samples.pattern, samples.blocks.texel, samples.random)) / count
        chosen[n], _ = draw_lights(scene, samples.sampling, uniform, per_arriving)
        aimed = scene.occluders.aim(scene.receivers, scene.lights, scene.distant, chosen=chosen[n])
        state[n, aimed.rows[:, 0]] = np.where(scene.occluders.occluded(aimed) == -1, CLEAR, BLOCKED)
        rays += len(aimed.rows)
    probability, effective = lights_that_count(scene, samples)
    deviation = REACH * math.sqrt(effective / count)
    steps, shares = neighbours.window(min(max(deviation, LEAST_TEXELS), MOST_TEXELS))
    values, cosine_visibility, error = np.empty((3, texels))
    draws = np.arange(count * len(steps) + 1)[:, None]
    certainty = -np.expm1(draws * np.log1p(-np.minimum(probability, ALMOST_SURE)))
    gather(
        scene.receivers.points, scene.normals, scene.receivers.normals, np.ascontiguousarray(scene.lights.T),
        scene.luminances, scene.distant, scene.least2, neighbours.number, neighbours.texel, neighbours.chart, steps,
        shares, chosen, state, certainty, values, cosine_visibility, error,
    )  # fmt: skip
    return IrradianceMap(values, cosine_visibility, error, rays, texels * count - rays, False)
