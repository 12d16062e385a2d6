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
from typing import no_type_check

import numpy as np
from jaxtyping import Float64, Int32

from pipeline.geometry.texels import Atlas
from pipeline.lighting.irradiance import IrradianceMap, Samples, draw_lights
from pipeline.lighting.light_sampling import pattern_numbers
from pipeline.lighting.light_scene import Scene
from pipeline.lighting.ray_kernels import kernel

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

BLOCKED, CLEAR, BELOW_HORIZON = 0, 1, 2


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


@kernel
@no_type_check
def gather(
    points, normals, face_normals, lights, luminances, distant, least2, number, texel, chart, steps, shares, chosen,
    state, certainty, values, cosine_visibility, error,
):  # fmt: skip
    """Fill the three maps; see the module's docstring.

    Args:
        lights: x, then y, then z [3, lights].
        number: texel at each row and column of the map, or -1.
        steps, shares: rows and columns to each neighbour, and its weight.
        chosen, state: light of each draw and texel, and what its ray met.
        certainty: P_j of each light after 0, 1, ... draws [draws, lights].
    """
    m, side = lights.shape[1], number.shape[0]
    asked, clear, squares = np.zeros(m), np.zeros(m), np.zeros(m)
    light, fall = np.empty(m), np.empty(m)
    for i in range(points.shape[0]):
        draws = 0
        for s in range(steps.shape[0]):
            row, column = texel[i, 0] + steps[s, 0], texel[i, 1] + steps[s, 1]
            if row < 0 or column < 0 or row >= side or column >= side:
                continue
            k = number[row, column]
            if k < 0 or chart[k] != chart[i]:
                continue
            draws += chosen.shape[0]
            for d in range(chosen.shape[0]):
                if state[d, k] != 2:
                    j = chosen[d, k]
                    asked[j] += shares[s]
                    squares[j] += shares[s] * shares[s]
                    clear[j] += shares[s] * state[d, k]
        sent, above, fallen, fallen_above = strengths(
            points[i], normals[i], face_normals[i], lights, luminances, distant, least2, light, fall
        )
        seen, known, seen_fall, known_fall = 0.0, 0.0, 0.0, 0.0
        noise, mixed, missing = 0.0, 0.0, 0.0
        for j in range(m):
            if asked[j] == 0:
                continue
            share, several = clear[j] / asked[j], asked[j] * asked[j] / squares[j]
            asked[j], clear[j], squares[j] = 0.0, 0.0, 0.0
            drawn = certainty[draws, j]
            weight = light[j] / drawn
            seen += weight * share
            known += weight
            seen_fall += fall[j] / drawn * share
            known_fall += fall[j] / drawn
            if several > 1:  # the unbiased variance of the mean; what one draw found varies in no way that it shows
                noise += weight * weight * share * (1 - share) / (several - 1)
            lost = (1 - drawn) * weight * weight
            noise += lost * share * share
            mixed += lost * share
            missing += lost
        # Where no ray says anything, nothing is known to be in the way.
        ratio = seen / known if known > 0 else 1.0
        values[i] = ratio * above / sent
        cosine_visibility[i] = (
            (seen_fall / known_fall if known_fall > 0 else ratio) * fallen_above / fallen if fallen > 0 else 0.0
        )
        variance = max(noise - 2 * ratio * mixed + ratio * ratio * missing, 0.0)
        error[i] = np.sqrt(variance) / known * above / sent if known > 0 else 0.0


@kernel
@no_type_check
def strengths(point, normal, face_normal, lights, luminances, distant, least2, light, fall):
    """L_j and L_j max(0, n . w_j) of every light, 0 below the face's horizon.

    Returns the sums of L_j over all lights and over those above the horizon, then both of the other.

    Without branches, so that four lights are computed at a time.
    """
    sent, above, fallen, fallen_above = 0.0, 0.0, 0.0, 0.0
    for j in range(luminances.shape[0]):
        dx, dy, dz, strength, inverse = lights[0, j], lights[1, j], lights[2, j], luminances[j], 1.0
        if not distant:
            dx, dy, dz = dx - point[0], dy - point[1], dz - point[2]
            squared = dx * dx + dy * dy + dz * dz
            inverse = 1.0 / np.sqrt(squared if squared > least2 else least2)
            strength *= inverse * inverse
        cosine = (dx * normal[0] + dy * normal[1] + dz * normal[2]) * inverse
        falls = strength * cosine if cosine > 0 else 0.0
        over = 1.0 if dx * face_normal[0] + dy * face_normal[1] + dz * face_normal[2] > 0 else 0.0
        light[j], fall[j] = over * strength, over * falls
        sent += strength
        fallen += falls
        above += over * strength
        fallen_above += over * falls
    return sent, above, fallen, fallen_above
