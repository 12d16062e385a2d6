"""Foreground crops of recorded images: colour-corrected, undistorted, with mask and camera."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float, Float32, Float64, Int

from pipeline.base.color import corrected
from pipeline.base.conventions import PIXEL_CENTER
from pipeline.capture.undistortion import Box, LensMap, undistort_image, undistort_mask
from pipeline.geometry.cameras import Camera

FOREGROUND = 0.5
"""A pixel is foreground if at least half of it is subject."""

SUBPIXEL_BITS = 8
"""Silhouette corners are rounded to 2^-8 pixel, far below what a mask of whole pixels can show."""


FINER = 4
"""Sub-pixels per side that a silhouette is painted with: its outline is then wider by up to an eighth of a pixel."""


@dataclass(frozen=True)
class Crop:
    """A part of an undistorted image.

    Attributes:
        box: in the undistorted image.
        image: linear RGB.
        mask: 0..1.
        camera: the pinhole camera that sees exactly this box.
    """

    box: Box
    image: Float32[np.ndarray, "h w 3"]
    mask: Float32[np.ndarray, "h w"]
    camera: Camera


def cut_crop(
    image: Float32[np.ndarray, "height width 3"],
    mask: Float32[np.ndarray, "height width"] | None,
    camera: Camera,
    *,
    corrected_from_raw: Float64[np.ndarray, "3 columns"] | None = None,
    undistort: bool = True,
    silhouette: Float32[np.ndarray, "height width"] | None = None,
    margin_px: int = 8,
    lens_map: LensMap | None = None,
) -> Crop | None:
    """Cut the foreground out of a recorded image; None if there is none.

    Args:
        image: linear RGB, black level removed; pixels that are not finite become black and lose their mask.
        mask: of the recorded (distorted) image, 0..1; or None, then `silhouette` is the mask.
        camera: as recorded, at the image's resolution.
        corrected_from_raw: colour correction (`corrected`); None skips it exactly.
        undistort: False skips resampling exactly, and takes the image as a pinhole's.
        silhouette: mask of the undistorted image.
        margin_px: background kept around the box of the foreground.
        lens_map: the camera's, if it has been made.
    """
    finite = np.isfinite(image).all(2)
    image = np.where(finite[..., None], image, np.float32(0))
    valid = finite.astype(np.float32)
    if mask is None:
        whole = (undistort_mask(valid, camera, lens_map) if undistort else valid) * silhouette
    else:
        whole = undistort_mask(mask * valid, camera, lens_map) if undistort else mask * valid
        if np.isin(mask, (0, 1)).all():
            # Resampling turns yes or no into fractions that say nothing about how much of a pixel is subject; an image
            # times such a fraction would have its edges, mixed with the dark background already, darkened twice.
            whole = (whole >= FOREGROUND).astype(np.float32)
    box = foreground_box(whole, margin_px)
    if box is None:
        return None
    part = undistort_image(image, camera, box, lens_map) if undistort else image[box.slices]
    if corrected_from_raw is not None:
        part = corrected(part, corrected_from_raw.astype(np.float32))
    return Crop(box, np.ascontiguousarray(part), np.ascontiguousarray(whole[box.slices]), crop_camera(camera, box))


def foreground_box(mask: Float[np.ndarray, "height width"], margin_px: int) -> Box | None:
    """The smallest box around the foreground, grown by a margin; None without foreground."""
    rows, columns = np.nonzero(mask >= FOREGROUND)
    if not len(rows):
        return None
    x0, y0 = max(0, int(columns.min()) - margin_px), max(0, int(rows.min()) - margin_px)
    x1, y1 = (min(n, int(i.max()) + 1 + margin_px) for n, i in ((mask.shape[1], columns), (mask.shape[0], rows)))
    return Box(x0, y0, x1 - x0, y1 - y0)


def crop_camera(camera: Camera, box: Box) -> Camera:
    """The pinhole camera of a crop: same pose, principal point moved, no distortion."""
    K = camera.K.copy()
    K[:2, 2] -= (box.x0, box.y0)
    return replace(camera.pinhole(), K=K, width=box.width, height=box.height)


def mesh_silhouette(
    vertices: Float[np.ndarray, "vertices 3"], faces: Int[np.ndarray, "faces 3"], camera: Camera
) -> Float32[np.ndarray, "height width"]:
    """Pixels of the undistorted image that a mesh covers at least half, 1, or not, 0.

    Faces that reach behind the camera are left out. Painted `FINER` times finer: OpenCV also fills the pixels that an
    outline touches, half of one on each side.
    """
    pixels, depth = camera.pinhole().project(vertices.astype(np.float64))
    in_front = (depth[faces] > 0).all(1)
    corners = np.round((pixels * FINER - PIXEL_CENTER)[faces[in_front]] * 2**SUBPIXEL_BITS)
    limit = float(2**30)  # OpenCV takes int32; what lies this far outside the image is cut there
    canvas = np.zeros((camera.height * FINER, camera.width * FINER), np.uint8)
    for triangle in np.clip(corners, -limit, limit).astype(np.int32):
        cv2.fillConvexPoly(canvas, triangle, 1, cv2.LINE_8, SUBPIXEL_BITS)
    covered = canvas.reshape(camera.height, FINER, camera.width, FINER).mean((1, 3), dtype=np.float32)
    return (covered >= FOREGROUND).astype(np.float32)
