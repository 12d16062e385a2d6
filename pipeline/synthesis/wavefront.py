"""Wavefront path tracing (Laine et al. 2013) by Mitsuba's vectorized variant `llvm_ad_rgb`.

It renders what the integrator `path` renders of surfaces under point lights, all cameras of a frame in one kernel, and
shares each camera ray among all lights: where a path meets a surface first, every light is looked at, so that the
choice of a light leaves no noise; at later vertices a few are. Only pixels that the subject may cover are traced.
Kernels are compiled once per process: what changes from frame to frame are their arguments.

Import it only where the variant runs (`renderer_choice`): it loads Dr.Jit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import drjit as dr
import numpy as np
from jaxtyping import Bool, Float32, Float64

from pipeline.synthesis.camera_rays import CameraRays, Samples, WavefrontView, scrambled
from pipeline.synthesis.mitsuba_scenes import mitsuba

LATER_LIGHTS = 4
"""Lights looked at from the second vertex of a path on. Few rays get there, whose neighbours in a packet would idle."""

COVERAGE_POSITIONS = 64
"""Places in a fine pixel that decide its coverage, where it may be covered in part."""


def render_views(
    scene: Any,
    views: Sequence[WavefrontView],
    positions: Float64[np.ndarray, "n 3"],
    intensities: Float64[np.ndarray, " n"],
    samples: int,
    max_depth: int,
) -> list[Float32[np.ndarray, "crop_height crop_width 4"]]:
    """Render the views' windows: radiance and coverage.

    Args:
        scene: meshes without lights, of the variant `llvm_ad_rgb`.
        positions, intensities: of the point lights.
        samples: places in a fine pixel from which light is gathered.
        max_depth: path edges from camera to light.
    """
    mi = mitsuba()
    lights = _Lights(mi.Float(np.ravel(positions)), mi.Float(intensities), len(intensities))
    images = CameraRays(views).render(samples, lambda *rays: _lit(scene, lights, max_depth, *rays), 4)
    partial = [replace(v, traced=v.traced & _uncertain(image[..., 3])) for v, image in zip(views, images, strict=True)]
    coverage = CameraRays(partial).render(COVERAGE_POSITIONS, lambda ray, _: [_hit(scene.ray_test(ray))], 1)
    for view, image, closer in zip(partial, images, coverage, strict=True):
        image[view.traced, 3] = closer[view.traced, 0]
    return images


def _uncertain(coverage: Float32[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Pixels in which, or beside which, not everything or not nothing was hit."""
    around = np.ones((3, 3), np.uint8)
    return (cv2.erode(coverage, around) < 1) & (cv2.dilate(coverage, around) > 0)


@dataclass(frozen=True)
class _Lights:
    """Point lights as arrays: x, y, z of one after the other, and their radiant intensities."""

    positions: Any
    intensities: Any
    count: int


def _lit(scene: Any, lights: _Lights, max_depth: int, ray: Any, samples: Samples) -> list[Any]:
    """Red, green, blue and coverage of rays."""
    radiance, hit = _trace(scene, lights, max_depth, ray, samples)
    return [radiance.x, radiance.y, radiance.z, _hit(hit)]


def _hit(mask: Any) -> Any:
    mi = mitsuba()
    return dr.select(mask, mi.Float(1), mi.Float(0))


def _trace(scene: Any, lights: _Lights, max_depth: int, ray: Any, samples: Samples) -> tuple[Any, Any]:
    """Radiance along camera rays, and whether they hit anything.

    At the first vertex of a path all lights are looked at, at later ones a few that follow each other. Which one comes
    first changes from sample to sample, and by the seed from pixel to pixel and vertex to vertex.
    """
    mi = mitsuba()
    context = mi.BSDFContext()
    light_count, later_count, most = (
        dr.opaque(mi.UInt32, n) for n in (lights.count, min(lights.count, LATER_LIGHTS), max_depth)
    )

    def gather_light(surface: Any, active: Any, first: Any, count: Any) -> Any:
        """Light that a vertex reflects to where its ray came from."""

        def look(looked_at: Any, gathered: Any) -> tuple[Any, Any]:
            light = (first + looked_at) % light_count
            position = dr.gather(mi.Point3f, lights.positions, light)
            offset = position - surface.p
            square = dr.squared_norm(offset)
            toward = surface.to_local(offset * dr.rsqrt(square))
            reflected = surface.bsdf().eval(context, surface, toward, active)
            lit = active & dr.any(reflected > 0)
            lit &= ~scene.ray_test(surface.spawn_ray_to(position), lit)
            intensity = dr.gather(mi.Float, lights.intensities, light)
            return looked_at + 1, gathered + dr.select(lit, reflected * intensity / square, 0)

        start = (mi.UInt32(0), mi.Color3f(0))
        _, gathered = dr.while_loop(start, lambda looked_at, _: active & (looked_at < count), look)
        return gathered * (mi.Float(light_count) / mi.Float(count))

    def follow(
        surface: Any, active: Any, radiance: Any, throughput: Any, depth: Any, count: Any, key: Any
    ) -> tuple[Any, ...]:
        """One vertex of the paths, and the way to the next."""
        radiance += throughput * gather_light(surface, active, samples.index * count + key % light_count, count)
        depth += 1
        active &= depth < most
        lobe, scramble = mi.sample_tea_32(key, depth)
        by_x, by_y = mi.sample_tea_32(lobe, scramble)
        which, where = mi.sample_tea_float32(samples.index ^ lobe, by_x), scrambled(samples.point, by_x, by_y)
        sample, weight = surface.bsdf().sample(context, surface, which, where, active)
        throughput *= weight
        active &= dr.any(throughput > 0)
        surface = scene.ray_intersect(surface.spawn_ray(surface.to_world(sample.wo)), active)
        active &= surface.is_valid()
        return surface, active, radiance, throughput, depth, later_count, scramble

    surface = scene.ray_intersect(ray, mi.RayFlags.All, True)
    hit = surface.is_valid()
    white, black = mi.Color3f(1), mi.Color3f(0)
    state = (surface, mi.Bool(hit), black, white, mi.UInt32(1), mi.UInt32(light_count), mi.UInt32(samples.seed))
    _, _, radiance, *_ = dr.while_loop(state, lambda _, active, *others: active, follow)
    return radiance, hit
