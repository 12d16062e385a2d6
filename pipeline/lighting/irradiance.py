"""Normalised irradiance per texel (RFGCA 15-16, A.1-A.3).

It says how much of the light sent to a point arrives there.

    Irradiance(v) = sum_j L_j(v) Vis_j(v) / sum_j L_j(v),   L_j(v) = I_j / |v - x_j|^2, luminance, no cosine.

Beside the papers' map stands a second one from the same rays, with L_j max(0, n . w_j) for L_j: the share of the light
falling on a matte surface that is not shadowed. The first mixes cast shadow with the surface's own horizon; the second
is the factor that direct light on a matte surface has to be multiplied by, and where the shadow network starts.

The denominator needs no rays and is always summed over all lights. The numerator is summed over all lights, or
estimated from N of them drawn with probability p_j: (1/N) sum L_j Vis_j / p_j, unbiased; single estimates may exceed 1.
The draws are stratified (the n-th lies in the n-th of N equal parts of the cumulative distribution), which keeps the
mean and lowers the variance. Distant lights, the pixels of an environment map, have a direction instead of a position,
and L_j = I_j.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float64, Int

from pipeline.lighting.draw_kernels import draw_by_arrival, draw_by_chance
from pipeline.lighting.light_sampling import SamplePattern, Sampling, pattern_numbers, pattern_uniforms
from pipeline.lighting.light_scene import Lights, Scene, light_scene
from pipeline.lighting.ray_kernels import add_clear_rays
from pipeline.lighting.shadow_rays import Rays, light_blocks
from pipeline.lighting.single_ray_kernels import trace_single_rays
from pipeline.lighting.standard_error import BlockVariance, TexelBlocks
from pipeline.lighting.visibility import Occluders

NOT_DRAWN = np.empty(0)
"""Probabilities of lights that were not drawn but all summed."""


@dataclass(frozen=True)
class Samples:
    """Number, probabilities and pattern of drawn lights.

    Attributes:
        count: per texel.
        sampling: probability of a light.
        pattern: how the draws of neighbouring texels hang together, see `pipeline.lighting.light_sampling`.
        blocks: where the points lie on the map.
    """

    count: int
    sampling: Sampling
    pattern: SamplePattern
    blocks: TexelBlocks
    random: np.random.Generator


@dataclass(frozen=True)
class IrradianceMap:
    """Irradiance per texel, and what it took.

    Attributes:
        values: the papers' normalised irradiance.
        cosine_visibility: the same weighted by the cosine; 0 where no light is above the horizon.
        error: standard error of `values`; 0 if no lights were drawn.
        rays: how many were traced.
        below_horizon: rays that would have been traced, had their light not been below their face's horizon.
        unlit: no light was on, so both are 1 by definition.
    """

    values: Float[np.ndarray, " t"]
    cosine_visibility: Float[np.ndarray, " t"]
    error: Float[np.ndarray, " t"]
    rays: int
    below_horizon: int
    unlit: bool


def trace_irradiance(
    occluders: Occluders,
    points: Float[np.ndarray, "t 3"],
    face_normals: Float[np.ndarray, "t 3"],
    lights: Lights,
    *,
    normals: Float[np.ndarray, "t 3"] | None = None,
    samples: Samples | None = None,
) -> IrradianceMap:
    """Irradiance of every point; see the module's docstring.

    Args:
        occluders: the posed mesh.
        points: on the mesh; `face_normals`: geometric, outward, unit length.
        normals: of the smooth surface, for the cosine; the faces' if not given.
        samples: how to draw lights, or None to sum over all of them.
    """
    scene = light_scene(occluders, points, face_normals, lights, normals)
    if scene is None:
        return unlit_map(len(points))
    return _trace_all(scene) if samples is None else _trace_drawn(scene, samples)


def unlit_map(points: int) -> IrradianceMap:
    """The map of a frame without a lit light: 1 everywhere.

    The ratio of sums leaves it open (0 / 0).
    """
    return IrradianceMap(np.ones(points), np.ones(points), np.zeros(points), 0, 0, True)


def _trace_all(scene: Scene) -> IrradianceMap:
    """A few lights at a time: neighbouring rays then run side by side, and memory does not grow with the lights."""
    arrived, cosine_arrived, rays = *np.zeros((2, len(scene.receivers))), 0
    for block in light_blocks(len(scene.receivers), len(scene.lights)):
        aimed = scene.occluders.aim(scene.receivers, scene.lights, scene.distant, block=block)
        rays += _add(scene, aimed, arrived, cosine_arrived)
    return exact_map(scene, arrived, cosine_arrived, rays, arrived.size * len(scene.lights))


def exact_map(scene: Scene, arrived: np.ndarray, cosine_arrived: np.ndarray, rays: int, pairs: int) -> IrradianceMap:
    """Make the map from the sums over what is seen. `pairs`: of point and light that rays were asked for."""
    values, cosine_visibility = scene.shares(arrived, cosine_arrived)
    return IrradianceMap(values, cosine_visibility, np.zeros_like(values), rays, pairs - rays, False)


def _trace_drawn(scene: Scene, samples: Samples) -> IrradianceMap:
    """A single draw often brings nothing, and then no sum over all lights is needed; several mostly bring something."""
    if samples.count == 1 and samples.sampling != "arriving":
        return _trace_single(scene, samples)
    values, cosine_arrived, rays = *np.zeros((2, len(scene.receivers))), 0
    variance, count = BlockVariance(samples.blocks), samples.count
    per_arriving, per_cosine_arriving = scene.per_arriving()
    for n in range(count):
        uniform = (n + pattern_numbers(samples.pattern, samples.blocks.texel, samples.random)) / count
        chosen, probability = draw_lights(scene, samples.sampling, uniform, per_arriving)
        aimed = scene.occluders.aim(scene.receivers, scene.lights, scene.distant, chosen=chosen)
        one = np.zeros_like(values)
        rays += _add(scene, aimed, one, cosine_arrived, probability)
        one *= per_arriving
        values += one
        variance.add(one)
    values /= count
    cosine_arrived *= per_cosine_arriving / count
    return IrradianceMap(values, cosine_arrived, variance.error_of_mean(count), rays, values.size * count - rays, False)


def _trace_single(scene: Scene, samples: Samples) -> IrradianceMap:
    """One ray per point; the draw's own error hides that of float32."""
    blocks, chances = samples.blocks, scene.chances(samples.sampling)
    uniforms = pattern_uniforms(samples.pattern, blocks.texel, samples.random)
    arrays = scene.lights, scene.luminances, scene.luminances / chances
    floats = [array.astype(np.float32) for array in arrays]
    values, cosine_visibility = np.empty((2, len(scene.receivers)), np.float32)
    sums, squares = np.zeros((2, len(blocks.count)))
    rays = trace_single_rays(
        scene.occluders.mesh.handle, scene.receivers.points, scene.receivers.normals, scene.normals, scene.lights,
        scene.distant, scene.least2, chances, uniforms.numbers, blocks.texel, uniforms.shift, scene.occluders.frame,
        *floats, blocks.block, values, cosine_visibility, sums, squares,
    )  # fmt: skip
    variance = BlockVariance(blocks)
    variance.add_sums(sums, squares)
    return IrradianceMap(values, cosine_visibility, variance.error_of_mean(1), rays, values.size - rays, False)


def _add(
    scene: Scene, rays: Rays, arrived: np.ndarray, cosine_arrived: np.ndarray, probability: np.ndarray = NOT_DRAWN
) -> int:
    """Trace rays and add what arrives along the clear ones; returns how many there were."""
    add_clear_rays(
        scene.receivers.points, scene.normals, scene.lights, scene.luminances, scene.distant, scene.least2,
        probability, rays.rows, scene.occluders.occluded(rays), arrived, cosine_arrived,
    )  # fmt: skip
    return len(rays.rows)


def draw_lights(
    scene: Scene,
    sampling: Sampling,
    uniform: Float64[np.ndarray, " t"],
    per_arriving: Float64[np.ndarray, " t"] | None = None,
) -> tuple[Int[np.ndarray, " t"], Float64[np.ndarray, " t"]]:
    """Draw one light per point, and tell the probability it had.

    By inversion of the cumulative distribution.

    Args:
        uniform: numbers in [0, 1), one per point.
        per_arriving: one over the sum of what would arrive at each point; needed for `arriving`.
    """
    chosen = np.empty(len(uniform), np.int32)
    if sampling != "arriving":
        chances = scene.chances(sampling)
        draw_by_chance(chances, uniform, chosen)
        return chosen, chances[chosen]
    probability = np.empty(len(uniform))
    draw_by_arrival(
        scene.receivers.points, scene.lights, scene.luminances, scene.distant, scene.least2, per_arriving,
        uniform, chosen, probability,
    )  # fmt: skip
    return chosen, probability
