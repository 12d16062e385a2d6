"""Writing OpenEXR images of linear light and of other numbers per pixel."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import OpenEXR
from jaxtyping import Float

from pipeline.base.files import written_whole

HALF_MAX = 65504.0
"""Largest finite half-precision number: brighter pixels are stored as this, so that a highlight stays finite."""


Channels = Mapping[str, Float[np.ndarray, "h w"]]


def write_exr(path: Path, image: Float[np.ndarray, "h w *channels"] | Channels, *, half: bool = True) -> None:
    """Write an OpenEXR file, whole or not at all; see `save_exr`."""
    with written_whole(path) as temporary:
        save_exr(temporary, image, half=half)


def save_exr(path: Path, image: Float[np.ndarray, "h w *channels"] | Channels, *, half: bool = True) -> None:
    """Write an OpenEXR file of half floats (clamped to their range) or floats, and its folder.

    [h, w, 3] becomes the channels R, G, B, [h, w] the channel Y; a mapping names its channels.

    Raises:
        OSError: if the system refuses, as when the disk is full.
    """
    if not isinstance(image, Mapping):
        if image.ndim not in (2, 3) or image.shape[2:] not in ((), (3,)):
            raise ValueError(f"{path.name}: expected shape [h, w] or [h, w, 3], found {list(image.shape)}")
        image = {"Y": image} if image.ndim == 2 else dict(zip("RGB", np.moveaxis(image, 2, 0), strict=True))
    planes = {
        name: np.clip(plane, -HALF_MAX, HALF_MAX).astype(np.float16) if half else plane.astype(np.float32)
        for name, plane in image.items()
    }
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    file = OpenEXR.File(header, {name: np.ascontiguousarray(plane) for name, plane in planes.items()})
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        file.write(str(path))
    except RuntimeError as error:  # OpenEXR's word for what the system refuses.
        raise OSError(f"{path}: {error}") from error
