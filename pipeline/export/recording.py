"""A capture as exports of it see it.

It has frames, images in linear light, and cameras of their size.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float32, Float64, UInt8

from pipeline.base.color import corrected
from pipeline.base.errors import InputError, listed
from pipeline.base.files import read_json, read_table
from pipeline.base.spread import spread
from pipeline.capture.images import ImageSource
from pipeline.effects.scene_evidence import read_colors
from pipeline.geometry.cameras import Camera, read_cameras


@dataclass(frozen=True)
class Recording:
    """A calibrated capture.

    Attributes:
        facts: capture.json of its index: kind, fps, images, template.
        cameras: at the resolution of the images.
        frames: frame, timestamp_s, segment, and test: True if it is held out as a whole; those that are exported.
        images: camera, frame, path, mask_path, of these frames.
        source: where the images are, and how they store light.
        colors: corrected-from-raw of cameras that have one.
        test_cameras: those that are held out.
    """

    facts: Mapping[str, Any]
    cameras: Mapping[str, Camera]
    frames: pd.DataFrame
    images: pd.DataFrame
    source: ImageSource
    colors: Mapping[str, Float64[np.ndarray, "3 columns"]]
    test_cameras: Sequence[str]

    def linear(self, camera: str, path: str, frame: int) -> Float32[np.ndarray, "h w 3"]:
        """An image in linear light, in the colours of the average camera.

        Raises:
            InputError: if it is not of its camera's size.
        """
        image = self.source.read(path, frame)
        known = self.cameras[camera]
        if image.shape[:2] != (known.height, known.width):
            found = f"{image.shape[1]} x {image.shape[0]}"
            raise InputError(f"{path}: expected {known.width} x {known.height} pixels, found {found}; index again")
        return corrected(image, self.colors.get(camera, np.eye(3))).astype(np.float32)

    def mask(self, camera: str, path: str) -> UInt8[np.ndarray, "h w"]:
        """The share of the subject in each pixel, 0..255, at the size of the images."""
        return self.source.read_mask(path, (self.cameras[camera].height, self.cameras[camera].width))


def read_recording(capture: Path, index: Path, cameras: Path, color: Path, frames: int) -> Recording:
    """Read what the index and the calibration say.

    Args:
        capture: folder of the capture.
        index: folder of index_capture.
        cameras: calibration/cameras.json.
        color: calibration/color.json.
        frames: how many, spread over all; 0: all.

    Raises:
        InputError: if a camera of the images is not calibrated.
    """
    facts, known = read_json(index / "capture.json"), read_cameras(cameras)
    images = read_table(index / "images.parquet")
    if absent := sorted(set(images.camera.astype(str)) - set(known)):
        raise InputError(f"{cameras}: expected all cameras of the images, found none of {listed(absent)}; calibrate")
    shown = set(images.frame.tolist())
    table = read_table(index / "frames.parquet")
    table = table[table.frame.isin(shown)]
    kept = spread(table.frame.tolist(), frames) if frames else table.frame.tolist()
    whole = images.groupby("frame")[["test_frame", "test_segment"]].first().any(axis=1)
    table = table[table.frame.isin(kept)].sort_values("frame", ignore_index=True)
    images = images[images.frame.isin(kept)].sort_values(["camera", "frame"], ignore_index=True)
    factor = facts["images"]["downsample_from_sensor"]
    return Recording(
        facts,
        {name: known[name].downsampled(factor) for name in sorted(set(images.camera.astype(str)))},
        table.assign(test=table.frame.map(whole)),
        images[["camera", "frame", "path", "mask_path"]],
        ImageSource.from_index(capture, facts["images"]),
        read_colors(color),
        sorted(set(images.camera.astype(str)[images.test_camera])),
    )
