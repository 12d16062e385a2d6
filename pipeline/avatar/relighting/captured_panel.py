"""Captured pictures beside those of a film, as one camera took them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from pipeline.base.color import srgb_from_linear
from pipeline.base.errors import InputError
from pipeline.base.splits import VALIDATION
from pipeline.capture.shards import read_image_shards
from pipeline.geometry.cameras import Camera


class CapturedPanel:
    """The pictures of one camera.

    Args:
        shards: folder with train/, test/ and validation/ of pack_shards.
        camera: its name.

    Raises:
        InputError: if there is no picture by this camera.
    """

    def __init__(self, shards: Path, camera: str) -> None:
        self.images = read_image_shards([shards / folder for folder in ("train", VALIDATION, "test")])
        table = self.images.table
        rows = np.flatnonzero(table.camera == camera)
        self.row_of_frame = dict(zip(table.frame.iloc[rows].tolist(), rows.tolist(), strict=True))
        if not self.row_of_frame:
            raise InputError(f"--beside-captured: expected pictures of {camera} in {shards}, found none; name another")

    def at(self, frame: int, camera: Camera) -> UInt8[np.ndarray, "h w 3"]:
        """The picture of a frame at the size of another of the same camera; black without one."""
        shape = (camera.height, camera.width)
        row = self.row_of_frame.get(frame)
        if row is None:
            return np.zeros((*shape, 3), np.uint8)
        image = self.images[row]
        scale = np.diag(camera.K[:2, :2]) / np.diag(image.K[:2, :2])
        # Between places in pixels; OpenCV counts from the middle of the first one.
        shift = camera.K[:2, 2] - scale * image.K[:2, 2] + 0.5 * scale - 0.5
        moved = np.concatenate([np.diag(scale), shift[:, None]], 1)
        shown = cv2.warpAffine(image.image, moved, shape[::-1], flags=cv2.INTER_LINEAR)
        return np.round(srgb_from_linear(shown.clip(0, 1)).clip(0, 1) * 255).astype(np.uint8)
