"""Captured pictures that the page shows beside its own, with their cameras."""

from __future__ import annotations

import base64
import io
from collections.abc import Collection
from typing import Any

import numpy as np
from PIL import Image

from pipeline.base.color import srgb_from_linear
from pipeline.base.spread import spread
from pipeline.capture.records import ImageRecord
from pipeline.capture.shards import ImageShards

JPEG_QUALITY = 90
"""Errors of half a percent of full scale, in a tenth of the bytes of a PNG."""


def choose_cameras(images: ImageShards, frames: Collection[int], count: int) -> list[str]:
    """At most `count` cameras with pictures of these frames, spread over their sorted names."""
    table = images.table
    return spread(sorted(set(table.camera[table.frame.isin(list(frames))])), count)


def captured_pictures(images: ImageShards, frames: Collection[int], cameras: Collection[str]) -> list[dict[str, Any]]:
    """Camera and JPEG of each picture by these cameras of these frames, for the page's JSON."""
    table = images.table
    rows = np.flatnonzero(table.frame.isin(list(frames)) & table.camera.isin(list(cameras)))
    return [described(images[int(row)]) for row in rows]


def described(image: ImageRecord) -> dict[str, Any]:
    """Camera from world, intrinsics of the crop, and the picture as it would be displayed."""
    shown = np.round(srgb_from_linear(image.image.clip(0, 1)).clip(0, 1) * 255).astype(np.uint8)
    stored = io.BytesIO()
    Image.fromarray(shown).save(stored, "JPEG", quality=JPEG_QUALITY, subsampling=0)
    return {
        "frame": image.frame, "camera": image.camera, "held_out": image.is_test or image.validation,
        "width": image.width, "height": image.height, "K": image.K.tolist(), "R": image.R.tolist(),
        "t": image.t.tolist(), "jpeg": base64.b64encode(stored.getvalue()).decode("ascii"),
    }  # fmt: skip
