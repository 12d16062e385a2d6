"""Calibration images as one grey channel, for detectors of boards, outlines and highlights."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32, UInt8

from pipeline.capture.images import read_stored
from pipeline.capture.video_frames import read_video_gray

WHITE_PERCENTILE = 99.5
"""Brightness of a float image that becomes white: one lamp in view must not turn the board black."""


def read_gray(path: Path) -> Float32[np.ndarray, "height width"]:
    """Mean of the channels; counts are divided by their maximum, floats stay. No transfer function is undone.

    Raises:
        InputError: if the file cannot be read.
    """
    stored = read_stored(path)
    scale = np.iinfo(stored.dtype).max if stored.dtype.kind == "u" else 1
    gray = stored[..., :3].mean(-1, dtype=np.float32) if stored.ndim == 3 else stored.astype(np.float32)
    return gray / np.float32(scale)


def read_gray_8bit(path: Path) -> UInt8[np.ndarray, "height width"]:
    """Read a grey image for detectors that want 8 bits: `read_gray`, rounded.

    Linear floats are brightened by their square root.

    Raises:
        InputError: if the file cannot be read.
    """
    gray = read_gray(path)
    if Path(path).suffix.lower() == ".exr":
        white = max(float(np.percentile(gray, WHITE_PERCENTILE)), 1e-12)
        gray = np.sqrt(np.clip(gray / white, 0, 1))
    return np.round(gray * 255).astype(np.uint8)


def read_view_gray(capture: Path, view: Mapping[str, Any]) -> UInt8[np.ndarray, "height width"]:
    """The image of a board that an entry of the index names: a file, or a frame of a video.

    Raises:
        InputError: if it cannot be read.
    """
    path = capture / view["path"]
    return read_video_gray(path, view["frame"]) if "frame" in view else read_gray_8bit(path)
