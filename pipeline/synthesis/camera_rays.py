"""Camera rays for the vectorized renderer: through all traced pixels of all cameras.

Import it only where the variant runs, as `wavefront`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from jaxtyping import Bool, Float64, Int64, UInt32

from pipeline.synthesis.lens import LensView
from pipeline.synthesis.mitsuba_scenes import mitsuba

LANES = 2**21
"""Rays per launch: enough to fill packets, few enough for some hundred megabytes."""


@dataclass(frozen=True)
class Samples:
    """Samples of pixels.

    Attributes:
        index: of each in its pixel.
        point: of `net_points`.
        seed: random, one per pixel.
    """

    index: Any
    point: Any
    seed: Any


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
    """Mark the fine pixels of a window that a mesh may cover.

    They are the boxes of its faces and one pixel around them.
    """
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


def net_points(count: int) -> UInt32[np.ndarray, "count 2"]:
    """First points of the (0, 2)-sequence of van der Corput and Sobol'.

    They are binary fractions of 32 bits (Kollig and Keller 2002).
    """
    index = np.arange(count, dtype=np.uint32)
    points = np.zeros((count, 2), np.uint32)
    corput, sobol = np.uint32(2**31), np.uint32(2**31)
    while index.any():
        odd = (index & 1).astype(bool)
        points[odd] ^= [corput, sobol]
        index, corput, sobol = index >> 1, corput >> 1, sobol ^ (sobol >> 1)
    return points


class CameraRays:
    """Camera rays of all traced pixels of all views, pixel after pixel."""

    def __init__(self, views: Sequence[WavefrontView]) -> None:
        self.views = views
        marked = [np.nonzero(view.traced) for view in views]
        self.count = sum(len(rows) for rows, _ in marked)
        of_view = np.repeat(np.arange(len(views)), [len(rows) for rows, _ in marked])
        self.columns = np.concatenate([columns for _, columns in marked]).astype(np.uint32)
        self.rows = np.concatenate([rows for rows, _ in marked]).astype(np.uint32)
        self.of_view = of_view.astype(np.uint32)

    def sampled(self, chunk: slice, samples: int) -> tuple[Any, Samples]:
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
        place = scrambled(point, scramble[0], scramble[1])
        x = (origin.x + mi.Float(column) + place.x) * scale
        y = (origin.y + mi.Float(row) + place.y) * scale
        axes = [of_view(mi.Vector3f, [camera.R[axis] for camera in cameras]) for axis in range(3)]
        direction = dr.normalize(axes[0] * x + axes[1] * y + axes[2])
        center = of_view(mi.Point3f, [camera.center for camera in cameras])
        return mi.Ray3f(center, direction), Samples(index, point, scramble[0] ^ scramble[1])

    def render(self, samples: int, trace: Callable[[Any, Samples], Sequence[Any]], channels: int) -> list[np.ndarray]:
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


def scrambled(point: Any, by_x: Any, by_y: Any) -> Any:
    """Points of `net_points` in the unit square, exclusive or random bits."""
    mi = mitsuba()
    return mi.Point2f(mi.Float((point.x ^ by_x) >> 8), mi.Float((point.y ^ by_y) >> 8)) * 2.0**-24
