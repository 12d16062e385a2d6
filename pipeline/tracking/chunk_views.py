"""Images, keypoints and outlines of the frames that a job tracks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Int64

from pipeline.base.files import read_distinct, read_json, read_rows
from pipeline.capture.images import ImageSource
from pipeline.config.track_mesh import TrackMesh
from pipeline.geometry.cameras import Camera
from pipeline.geometry.signed_distance import View
from pipeline.tracking.image_cameras import CAMERA_COLUMNS, image_cameras
from pipeline.tracking.tracking_inputs import mask_views


@dataclass(frozen=True)
class ChunkViews:
    """Views of the frames of a chunk; nothing of the capture's other frames is read.

    Attributes:
        frames: their numbers, with those of the context.
        cameras: that take part, at the images' size.
        source, images: the images and the rows of their table.
        keypoints: rows of the table of these frames.
        masked: outlines by camera; none if they are not asked for.
    """

    frames: Int64[np.ndarray, " frames"]
    cameras: dict[str, Camera]
    source: ImageSource
    images: pd.DataFrame
    keypoints: pd.DataFrame
    masked: dict[str, View]


def read_chunk(
    capture: Path, index: Path, cameras: Path, frames: Int64[np.ndarray, " frames"], settings: TrackMesh, *,
    masks: bool, test_cameras: bool,
) -> ChunkViews:  # fmt: skip
    """Read what the cameras see in some frames.

    With outlines, and with held-out cameras, where they are asked for.

    Raises:
        InputError: if a camera is not calibrated, or fewer than two take part.
    """
    stored, table = read_json(index / "capture.json")["images"], index / "images.parquet"
    source, every = ImageSource.from_index(capture, stored), read_distinct(table, CAMERA_COLUMNS)
    used = image_cameras(cameras, every, float(stored["downsample_from_sensor"]), test_cameras)
    images = read_rows(table, "frame", frames)
    masked = {}
    if masks:
        masked = mask_views(source, images, used, frames, settings.outline_cameras, settings.outline_size_px)
    keypoints = read_rows(index / "keypoints_2d.parquet", "frame", frames)
    return ChunkViews(frames, used, source, images, keypoints, masked)
