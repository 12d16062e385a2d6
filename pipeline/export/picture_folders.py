"""Images and masks of a recording as .png files, as COLMAP and nerfstudio read them."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.progress import progress
from pipeline.capture.images import write_png
from pipeline.export.recording import Recording

log = logging.getLogger(__name__)


def image_name(camera: str, frame: int) -> str:
    """Name of an image below the folder of images: a folder per camera."""
    return f"{camera}/{frame:06d}.png"


def write_pictures(folder: Path, recording: Recording, exposure: float, mask_name: Callable[[str], str]) -> None:
    """Write images/CAMERA/FRAME.png, 8-bit sRGB, and their masks, of those that have one.

    Args:
        exposure: factor on linear light before it is encoded; what exceeds 1 is cut off, which is said.
        mask_name: path of a mask below masks/, by the name of its image.
    """
    bright = []
    for row in progress(list(recording.images.itertuples()), "images"):
        camera, name = str(row.camera), image_name(str(row.camera), row.frame)
        linear = exposure * recording.linear(camera, row.path, row.frame)
        bright.append(float((linear > 1).any(-1).mean()))
        write_png(folder / "images" / name, linear)
        if not pd.isna(row.mask_path):
            write_png(folder / "masks" / mask_name(name), recording.mask(camera, row.mask_path))
    masks = int(recording.images.mask_path.notna().sum())
    log.info(
        "%d images, %d masks; %.2g %% of pixels are brighter than white", len(bright), masks, 100 * np.mean(bright)
    )
