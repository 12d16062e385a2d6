"""Brightness of the subject in each image, where it is, and how the image stores it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.progress import progress
from pipeline.capture.images import ImageSource
from pipeline.capture.shared_masks import SharedMasks
from pipeline.sync.stored_levels import LEVELS, stored_levels

SUBJECT = 128
"""Mask values from here on are subject: at least half of the pixel."""

MEASURED = ["camera", "frame", "r", "g", "b", "x", "y", "xx", "xy", "yy", *LEVELS]


def measure_brightness(capture: Path, images: pd.DataFrame, cameras: list[str], facts: dict) -> pd.DataFrame:
    """Measure per image the subject's mean colour, its place, and its stored levels.

    The place is the mean x, y of its pixels and their covariance xx, xy, yy; for the levels see `stored_levels`.

    Without masks the whole image is averaged (the background of a stage is dark), x, y is the image's centre and the
    covariance NaN. Where some images of a camera have masks, the others get that of the nearest frame: means over the
    subject and over whole images do not compare. Images without a finite subject pixel are left out.
    """
    rows, source = [], ImageSource.from_index(capture, facts)
    chosen = images[images.camera.isin(cameras)]
    mask_paths = nearest_masks(chosen)
    masks = SharedMasks(source, mask_paths)
    for row, mask_path in progress(list(zip(chosen.itertuples(), mask_paths, strict=True)), "book_patterns"):
        image = source.read(row.path, row.frame)
        subject = np.isfinite(image).all(2)
        masked = mask_path is not None
        if masked:
            subject &= masks.read(mask_path, image.shape) >= SUBJECT
        if not subject.any():
            continue
        y, x = np.nonzero(subject)
        covariance = np.cov(x, y, bias=True)[[0, 0, 1], [0, 1, 1]] if masked else np.full(3, np.nan)
        pixels = image[subject]
        color, levels = pixels.mean(0, dtype=np.float64), stored_levels(pixels)
        rows.append((row.camera, row.frame, *color, x.mean() + 0.5, y.mean() + 0.5, *covariance, *levels))
    return pd.DataFrame(rows, columns=MEASURED)


def nearest_masks(images: pd.DataFrame) -> list[str | None]:
    """Each image's mask, or that of the camera's nearest frame that has one, or None."""
    found: dict[tuple[str, int], str] = {}
    for camera, rows in images[images.mask_path.notna()].groupby("camera"):
        frames, paths = rows.frame.to_numpy(), rows.mask_path.to_numpy()
        own = images.frame[images.camera == camera].to_numpy()
        nearest = np.abs(own[:, None] - frames[None]).argmin(1)
        found |= {(camera, int(frame)): str(paths[k]) for frame, k in zip(own, nearest, strict=True)}
    return [found.get((row.camera, row.frame)) for row in images.itertuples()]
