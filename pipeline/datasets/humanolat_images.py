"""Images of HumanOLAT: the light that each shows."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.errors import InputError
from pipeline.capture.archives import read_bytes
from pipeline.datasets.light_durations import light_name

MODEL, MASKS, IMAGES = "model/model.obj", "segmentations/masks/000", "images_processed"
CALIBRATION, LIGHTS, ORDER = "cameras.calib", "LSX_light_positions_aligned.pc", "LSX3_light_z_spiral.txt"

FULL_IMAGE = 14
"""Number of the image with all lights on."""

EARLIER_IMAGES = range(1, FULL_IMAGE)
"""Images of gradients and environments; image 0 has all lights on, too."""

FIRST_SKIPPED, SKIP_STEP = 34, 21
"""The images 34, 55, 76, ... show no single light."""


def image_of(k: int) -> int:
    """Number of the image of the kth light in the order of firing, which counts from 0."""
    # Skipped are FIRST_SKIPPED, 19 lights after the first, and from there every SKIP_STEP-th.
    return FULL_IMAGE + 1 + k + (k + 1) // (SKIP_STEP - 1)


def read_light_points(path: Path) -> pd.DataFrame:
    """light, x, y, z of the lines `v x y z`, metres.

    Raises:
        InputError: if there is none.
    """
    rows = [line.split()[1:4] for line in read_bytes(path).decode().splitlines() if line.startswith("v ")]
    try:
        places = np.array(rows, np.float64)
    except ValueError:
        places = np.zeros(0)
    if places.ndim != 2 or places.shape[1:] != (3,) or not np.isfinite(places).all():
        raise InputError(f"{path}: expected lines 'v x y z', found {len(rows)} that are none")
    names = [light_name(number) for number in range(len(places))]
    return pd.DataFrame({"light": names, **dict(zip("xyz", places.T, strict=True))})


def read_order(path: Path, lights: int) -> list[int]:
    """Lights, counted from 0, in the order in which they fire.

    Raises:
        InputError: if the file does not name each light once.
    """
    words = read_bytes(path).decode().split()
    order = [int(word) - 1 for word in words if re.fullmatch(r"\d+", word)]
    if sorted(order) != list(range(lights)):
        raise InputError(f"{path}: expected the numbers 1 to {lights}, each once, found {len(order)} numbers")
    return order
