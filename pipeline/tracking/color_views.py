"""The images of some frames, as tracking compares them: linear, blurred within the subject."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import pandas as pd
from jaxtyping import Bool, Float32, Int64

from pipeline.base.progress import progress
from pipeline.base.spread import evenly
from pipeline.capture.images import ImageSource
from pipeline.capture.reduced_images import block_means, reduction
from pipeline.geometry.cameras import Camera

LEAST_SHARE = 1e-3
"""Share of a blurred pixel that shows the subject below which it has no colour; rounding stays far below."""


@dataclass(frozen=True)
class ColorView:
    """One camera's images of some frames, linear RGB.

    Attributes:
        camera: at the resolution of these images.
        images: of the frames that have one.
        masks: share of each pixel that shows the subject; 1 throughout where there is no mask.
        row: in `images` and `masks`, of each frame; -1 where a frame has none.
    """

    camera: Camera
    images: Float32[np.ndarray, "rows height width 3"]
    masks: Float32[np.ndarray, "rows height width"]
    row: Int64[np.ndarray, " frames"]

    @property
    def usable(self) -> Bool[np.ndarray, " frames"]:
        """Frames that have an image."""
        return self.row >= 0

    def at(self, frames: Int64[np.ndarray, " some"]) -> ColorView:
        """The view in some of the frames."""
        return replace(self, row=self.row[frames])

    def blurred(self, sigma_px: float) -> ColorView:
        """The view through a Gaussian blur of the subject alone.

        Blurred colours are divided by the blurred mask, so the background does not bleed into the subject.
        """
        images = np.empty_like(self.images)
        for blurred, image, mask in zip(images, self.images, self.masks, strict=True):
            share = cv2.GaussianBlur(mask, (0, 0), sigma_px)
            light = cv2.GaussianBlur(image * mask[..., None], (0, 0), sigma_px)
            shown = (share > LEAST_SHARE)[..., None]
            blurred[:] = np.where(shown, light / np.maximum(share, LEAST_SHARE)[..., None], 0)
        return replace(self, images=images)


def read_color_views(
    source: ImageSource, images: pd.DataFrame, cameras: dict[str, Camera], frames: Int64[np.ndarray, " frames"],
    wanted: Int64[np.ndarray, " wanted"], most: int, longest_px: int,
) -> list[ColorView]:  # fmt: skip
    """Read some frames' images, at reduced size, from evenly chosen cameras.

    Args:
        source: the capture's images.
        images: camera, frame, path and mask_path of each image.
        cameras: at the resolution of the images.
        frames: frame numbers of the result.
        wanted: positions in `frames` to read; the others have no image.
        most: cameras at most, chosen by sorted name.
        longest_px: images are reduced until their longer side has this at most.
    """
    names = evenly(sorted(cameras), most)
    views = []
    for name in progress(names, "read images"):
        factor, rows = reduction(cameras[name], longest_px), images[images.camera == name].set_index("frame")
        camera = cameras[name].downsampled(float(factor))
        usable = np.isin(frames, frames[wanted]) & np.isin(frames, rows.index)
        row = np.where(usable, np.cumsum(usable) - 1, -1)
        stack = np.empty((np.count_nonzero(usable), camera.height, camera.width, 3), np.float32)
        masks = np.empty(stack.shape[:3], np.float32)
        for f in np.flatnonzero(usable):
            image = source.read(rows.path[frames[f]], int(frames[f]))
            finite = np.isfinite(image).all(2)
            path = rows.mask_path[frames[f]]
            share = 1.0 if pd.isna(path) else source.read_mask(path, image.shape).astype(np.float32) / 255
            share = share * finite.astype(np.float32)
            # Weighted by the mask: the background does not bleed into the subject.
            masks[row[f]] = block_means(share, factor, camera)
            light = block_means(np.where(finite[..., None], image, 0) * share[..., None], factor, camera)
            stack[row[f]] = light / np.maximum(masks[row[f]], LEAST_SHARE)[..., None]
        views.append(ColorView(camera, stack, masks, row))
    return views
