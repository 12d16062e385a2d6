"""The surface that pixels of a picture show, where they show it well."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64
from scipy.ndimage import maximum_filter, minimum_filter

from pipeline.capture.records import ImageRecord
from pipeline.geometry.cameras import Camera
from pipeline.geometry.depth_maps import DEPTH_STEP_M, draw_depth
from pipeline.geometry.mesh import unit_or

BESIDE = 3
"""Width in pixels of the square around a pixel that has to show one surface."""


@dataclass(frozen=True)
class SeenSurface:
    """Points and normals behind the pixels of an image, in the frame of its camera.

    Attributes:
        seen: pixels of the subject around which one surface alone is seen.
        points: of all pixels, metres; far away where no surface is.
        normals: of the surface between the neighbours of each pixel, towards the camera.
        focal: fx and fy, pixels.
    """

    seen: Bool[np.ndarray, "h w"]
    points: Float64[np.ndarray, "h w 3"]
    normals: Float64[np.ndarray, "h w 3"]
    focal: Float64[np.ndarray, " 2"]

    def motion_columns(self, rgb: Float64[np.ndarray, "h w 3"]) -> Float64[np.ndarray, "pixels 3 6"]:
        """Changes of a picture at the seen pixels, per radian and metre of `CameraOffsets`.

        A point that moves by dp in the picture takes its colour along: dI = -grad I . dp.
        """
        down, right = np.gradient(rgb, axis=(0, 1))
        slope = np.stack([right, down], -1)[self.seen] * self.focal
        x = self.points[self.seen]
        depth = x[:, 2:]
        along = -(slope @ (x[:, :2, None] / depth[:, None]))[..., 0]
        shift = -np.concatenate([slope, along[..., None]], -1) / depth[:, None]
        return np.concatenate([np.cross(x[:, None], shift), shift], -1)  # dI . (w x x) = w . (x x dI)


def seen_surface(image: ImageRecord, vertices: Float64[np.ndarray, "vertices 3"], faces: np.ndarray) -> SeenSurface:
    """The posed mesh as the camera of an image sees it."""
    K, (height, width) = image.K, image.mask.shape
    camera = Camera(R=image.R, t=image.t, K=K, dist=np.zeros(5), width=width, height=height)
    depth = draw_depth(camera, vertices, faces).astype(np.float64)
    depth = np.where(np.isfinite(depth), depth, np.finfo(np.float32).max)
    one = maximum_filter(depth, BESIDE) - minimum_filter(depth, BESIDE) < DEPTH_STEP_M
    inside = minimum_filter(image.mask, BESIDE) > 1 - 1 / 255
    row, column = np.mgrid[:height, :width] + 0.5
    rays = np.stack([(column - K[0, 2]) / K[0, 0], (row - K[1, 2]) / K[1, 1], np.ones_like(row)], -1)
    points = rays * np.where(one, depth, 1.0)[..., None]
    down, right = np.gradient(points, axis=(0, 1))
    normals = unit_or(np.cross(down, right), 0.0)  # x right, y down, z forward: this one looks back at the camera
    return SeenSurface(one & inside & (depth < np.finfo(np.float32).max), points, normals, K[[0, 1], [0, 1]].copy())
