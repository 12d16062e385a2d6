"""Exact lens distortion for a renderer that only knows pinholes.

The part of an image that matters (its window) is rendered by a pinhole camera of the same pose on a finer grid.
Every image pixel then averages k x k points of that rendering, each found by undistorting the point's position in
the distorted image: the geometry is exact, and only the look-up between fine samples is interpolated.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Float64

from pipeline.base.conventions import PIXEL_CENTER
from pipeline.geometry.cameras import Camera

BORDER = 2
"""Fine pixels rendered beyond the outermost look-up. For bilinear interpolation and rounding."""


@dataclass(frozen=True)
class LensView:
    """A window of one camera's image, and the pinhole rendering it is looked up from.

    Attributes:
        camera: the camera at the resolution of the image wanted, with distortion.
        window: x, y, width, height of the window in image pixels.
        samples: look-up points per image pixel along one axis (k), also the fine grid's resolution factor.
        lookup: positions [k * height, k * width, 2] in the cropped pinhole rendering, first pixel centre at 0.5.
        focal: pinhole focal length in fine pixels.
        film: width and height of the whole pinhole film, principal point in its middle.
        crop: x, y, width, height of the part of the film to render.
    """

    camera: Camera
    window: tuple[int, int, int, int]
    samples: int
    lookup: Float32[np.ndarray, "rows columns 2"]
    focal: float
    film: tuple[int, int]
    crop: tuple[int, int, int, int]

    def develop(self, rendered: Float32[np.ndarray, "crop_height crop_width channels"]) -> Float32[np.ndarray, "h w c"]:
        """The window's pinhole rendering to the whole distorted image; zero outside the window."""
        x, y, width, height = self.window
        at = self.lookup - PIXEL_CENTER  # OpenCV counts from pixel centres
        fine = cv2.remap(rendered, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        averaged = cv2.resize(fine, (width, height), interpolation=cv2.INTER_AREA).reshape(height, width, -1)
        image = np.zeros((self.camera.height, self.camera.width, averaged.shape[-1]), dtype=np.float32)
        image[y : y + height, x : x + width] = averaged
        return image


def undistorted_grid(camera: Camera, samples: int, window: tuple[int, int, int, int]) -> Float64[np.ndarray, "y x 2"]:
    """Look-up points of a window (x, y, width, height), undistorted, at depth 1."""
    x, y, width, height = window
    steps_x = x + (np.arange(samples * width) + 0.5) / samples
    steps_y = y + (np.arange(samples * height) + 0.5) / samples
    positions = np.stack(np.meshgrid(steps_x, steps_y), axis=-1)
    return camera.undistort(positions.reshape(-1, 2)).reshape(positions.shape)


def whole_grid(camera: Camera, samples: int) -> Float64[np.ndarray, "y x 2"]:
    """`undistorted_grid` of a whole image, for views that share it."""
    return undistorted_grid(camera, samples, (0, 0, camera.width, camera.height))


def view_window(
    camera: Camera,
    pixels: Float64[np.ndarray, "n 2"],
    samples: int,
    margin: int = 2,
    grid: Float64[np.ndarray, "y x 2"] | None = None,
) -> LensView:
    """View whose window holds all `pixels` (image coordinates).

    The window has `margin` pixels around them and is cut to the image. With `grid`, a `whole_grid`, nothing has to be
    undistorted.
    """
    low = np.floor(pixels.min(axis=0)).astype(int) - margin
    high = np.ceil(pixels.max(axis=0)).astype(int) + margin
    size = np.array([camera.width, camera.height])
    low, high = low.clip(0, size - 1), high.clip(1, size)
    high = np.maximum(high, low + 1)
    width, height = (high - low).tolist()
    if grid is None:
        normalized = undistorted_grid(camera, samples, (*low.tolist(), width, height))
    else:
        rows, columns = (slice(samples * a, samples * b) for a, b in zip(low[::-1], high[::-1], strict=True))
        normalized = grid[rows, columns]
    focal = samples * float(camera.K[0, 0] + camera.K[1, 1]) / 2
    fine = focal * normalized
    # One axis after the other: numpy is slow at extremes of pairs.
    least, most = (np.array([extreme(fine[..., axis]) for axis in (0, 1)]) for extreme in (np.min, np.max))
    film = 2 * (np.ceil(np.maximum(-least, most)).astype(int) + BORDER)
    fine = fine + film / 2
    crop_low = (np.floor(least + film / 2).astype(int) - BORDER).clip(0, None)
    crop_high = np.minimum(np.ceil(most + film / 2).astype(int) + BORDER, film)
    return LensView(
        camera=camera,
        window=(int(low[0]), int(low[1]), width, height),
        samples=samples,
        lookup=(fine - crop_low).astype(np.float32),
        focal=focal,
        film=(int(film[0]), int(film[1])),
        crop=(*crop_low.tolist(), *(crop_high - crop_low).tolist()),
    )


def view_points(
    camera: Camera,
    points: Float64[np.ndarray, "n 3"],
    samples: int,
    margin: int = 2,
    grid: Float64[np.ndarray, "y x 2"] | None = None,
) -> LensView:
    """View whose window holds the image of all world points (metres).

    Otherwise as `view_window`. They must lie in front of the camera.
    """
    pixels, _ = camera.project(points)
    return view_window(camera, pixels, samples, margin, grid)
