"""Wavefront path tracing (Laine et al. 2013) by Mitsuba's vectorized variant `llvm_ad_rgb`.

It renders what the integrator `path` renders of surfaces under point lights, all cameras of a frame in one kernel, and
shares each camera ray among all lights: where a path meets a surface first, every light is looked at, so that the
choice of a light leaves no noise; at later vertices a few are. Only pixels that the subject may cover are traced.
Kernels are compiled once per process: what changes from frame to frame are their arguments.

Import it only where the variant runs (`llvm_backend`): it loads Dr.Jit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import drjit as dr
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64, UInt32

from pipeline.synthesis.lens import LensView
from pipeline.synthesis.mitsuba_scenes import mitsuba

LATER_LIGHTS = 4
"""Lights looked at from the second vertex of a path on. Few rays get there, whose neighbours in a packet would idle."""

COVERAGE_POSITIONS = 64
"""Places in a fine pixel that decide its coverage, where it may be covered in part."""

LANES = 2**21
"""Rays per launch: enough to fill packets, few enough for some hundred megabytes."""


@dataclass(frozen=True)
class WavefrontView:
    """A view to render.

    Attributes:
        traced: pixels of the view's window that are traced; the others stay zero.
        seed: of its samples.
    """

    view: LensView
    traced: Bool[np.ndarray, "crop_height crop_width"]
    seed: int


def traced_pixels(
    view: LensView, vertices: Float64[np.ndarray, "v 3"], faces: Int64[np.ndarray, "f 3"]
) -> Bool[np.ndarray, "crop_height crop_width"]:
    """Mark the fine pixels of a window that a mesh may cover: the boxes of its faces and one pixel around them."""
    x, y, width, height = view.crop
    in_camera = vertices @ view.camera.R.T + view.camera.t
    at = view.focal * in_camera[:, :2] / in_camera[:, 2:] + np.array(view.film) / 2 - [x, y]
    corners = at[faces]
    low = (np.floor(corners.min(axis=1)).astype(int) - 1).clip(0, [width, height])
    high = (np.floor(corners.max(axis=1)).astype(int) + 2).clip(0, [width, height])
    # Boxes are summed as differences at their corners, as in a summed-area table (Crow 1984) read backwards.
    steps = np.zeros((height + 1, width + 1), np.int64)
    for rows, columns, sign in ((low, low, 1), (high, high, 1), (low, high, -1), (high, low, -1)):
        np.add.at(steps, (rows[:, 1], columns[:, 0]), sign)
    return steps.cumsum(axis=0).cumsum(axis=1)[:height, :width] > 0


def render_views(
    scene: Any,
    views: Sequence[WavefrontView],
    positions: Float64[np.ndarray, "n 3"],
    intensities: Float64[np.ndarray, "n"],
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
    images = _Rays(views).render(samples, lambda *rays: _lit(scene, lights, max_depth, *rays), 4)
    partial = [replace(v, traced=v.traced & _uncertain(image[..., 3])) for v, image in zip(views, images, strict=True)]
    coverage = _Rays(partial).render(COVERAGE_POSITIONS, lambda ray, _: [_hit(scene.ray_test(ray, True))], 1)
    for view, image, closer in zip(partial, images, coverage, strict=True):
        image[view.traced, 3] = closer[view.traced, 0]
    return images


def _uncertain(coverage: Float32[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Pixels in which, or beside which, not everything or not nothing was hit."""
    around = np.ones((3, 3), np.uint8)
    return (cv2.erode(coverage, around) < 1) & (cv2.dilate(coverage, around) > 0)


def net_points(count: int) -> UInt32[np.ndarray, "count 2"]:
    """First points of the (0, 2)-sequence of van der Corput and Sobol', as binary fractions of 32 bits."""
    index = np.arange(count, dtype=np.uint32)
    points = np.zeros((count, 2), np.uint32)
    corput, sobol = np.uint32(2**31), np.uint32(2**31)
    while index.any():
        odd = (index & 1).astype(bool)
        points[odd] ^= [corput, sobol]
        index, corput, sobol = index >> 1, corput >> 1, sobol ^ (sobol >> 1)
    return points


@dataclass(frozen=True)
class _Samples:
    """Samples of pixels: the index of each in its pixel, its point of `net_points`, and a random seed per pixel."""

    index: Any
    point: Any
    seed: Any


@dataclass(frozen=True)
class _Lights:
    """Point lights as arrays: x, y, z of one after the other, and their radiant intensities."""

    positions: Any
    intensities: Any
    count: int


class _Rays:
    """Camera rays of all traced pixels of all views, pixel after pixel."""

    def __init__(self, views: Sequence[WavefrontView]) -> None:
        self.views = views
        marked = [np.nonzero(view.traced) for view in views]
        self.count = sum(len(rows) for rows, _ in marked)
        of_view = np.repeat(np.arange(len(views)), [len(rows) for rows, _ in marked])
        self.columns = np.concatenate([columns for _, columns in marked]).astype(np.uint32)
        self.rows = np.concatenate([rows for rows, _ in marked]).astype(np.uint32)
        self.of_view = of_view.astype(np.uint32)

    def sampled(self, chunk: slice, samples: int) -> tuple[Any, _Samples]:
        """Rays through low-discrepancy positions in each pixel, and their samples."""
        mi = mitsuba()
        per_pixel = dr.opaque(mi.UInt32, samples)
        lane = dr.arange(mi.UInt32, (chunk.stop - chunk.start) * samples)
        pixel = lane // per_pixel
        index = lane - pixel * per_pixel

        def of_pixel(values: np.ndarray) -> Any:
            return dr.gather(mi.UInt32, mi.UInt32(values[chunk]), pixel)

        view, column, row = (of_pixel(values) for values in (self.of_view, self.columns, self.rows))
        cameras = [entry.view.camera for entry in self.views]
        # The pinhole's film of a view begins at its crop; its principal point is in the middle of the film.
        start = [np.array(v.view.crop[:2]) - np.array(v.view.film) / 2 for v in self.views]
        seeds = dr.gather(mi.UInt32, mi.UInt32([entry.seed for entry in self.views]), view)
        scramble = mi.sample_tea_32(column + row * mi.UInt32(2**16), seeds)

        def of_view(kind: Any, values: list) -> Any:
            return dr.gather(kind, mi.Float(np.ravel(values)), view)

        scale = of_view(mi.Float, [1 / entry.view.focal for entry in self.views])
        origin = of_view(mi.Point2f, start)
        point = dr.gather(mi.Point2u, mi.UInt32(np.ravel(net_points(samples))), index)
        place = _scrambled(point, scramble[0], scramble[1])
        x = (origin.x + mi.Float(column) + place.x) * scale
        y = (origin.y + mi.Float(row) + place.y) * scale
        axes = [of_view(mi.Vector3f, [camera.R[axis] for camera in cameras]) for axis in range(3)]
        direction = dr.normalize(axes[0] * x + axes[1] * y + axes[2])
        center = of_view(mi.Point3f, [camera.center for camera in cameras])
        return mi.Ray3f(center, direction), _Samples(index, point, scramble[0] ^ scramble[1])

    def render(self, samples: int, trace: Callable[[Any, _Samples], Sequence[Any]], channels: int) -> list[np.ndarray]:
        """Images of the means over pixels of what `trace` finds along rays; zero where none are.

        Args:
            trace: values of rays and their samples, an array per channel.
        """
        values = np.zeros((self.count, channels), np.float32)
        step = max(1, LANES // samples)
        for first in range(0, self.count, step):
            chunk = slice(first, min(first + step, self.count))
            found = trace(*self.sampled(chunk, samples))
            dr.eval(found)  # together: each alone would trace all paths anew
            values[chunk] = np.stack([np.array(dr.block_sum(channel, samples)) for channel in found], axis=1) / samples
        images, first = [], 0
        for entry in self.views:
            image = np.zeros((*entry.traced.shape, channels), np.float32)
            count = int(entry.traced.sum())
            image[entry.traced] = values[first : first + count]
            images.append(image)
            first += count
        return images


def _lit(scene: Any, lights: _Lights, max_depth: int, ray: Any, samples: _Samples) -> list[Any]:
    """Red, green, blue and coverage of rays."""
    radiance, hit = _trace(scene, lights, max_depth, ray, samples)
    return [radiance.x, radiance.y, radiance.z, _hit(hit)]


def _hit(mask: Any) -> Any:
    mi = mitsuba()
    return dr.select(mask, mi.Float(1), mi.Float(0))


def _scrambled(point: Any, by_x: Any, by_y: Any) -> Any:
    """Points of `net_points` in the unit square, exclusive or random bits (Kollig and Keller 2002)."""
    mi = mitsuba()
    return mi.Point2f(mi.Float((point.x ^ by_x) >> 8), mi.Float((point.y ^ by_y) >> 8)) * 2.0**-24


def _trace(scene: Any, lights: _Lights, max_depth: int, ray: Any, samples: _Samples) -> tuple[Any, Any]:
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
        which, where = mi.sample_tea_float32(samples.index ^ lobe, by_x), _scrambled(samples.point, by_x, by_y)
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
