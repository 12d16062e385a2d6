"""Photographs of mirror balls in a capture: their outlines and bright spots."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float32, Float64

from pipeline.base.color import linear_from_srgb
from pipeline.base.progress import progress
from pipeline.calibration.lights.ball_highlights import Spot, measure_spots
from pipeline.calibration.lights.ball_images import measure_outline, why_no_ball
from pipeline.capture.images import Transfer, read_stored

log = logging.getLogger("ball_photos")

CLIPPED = 0.98
"""Stored value, over the largest, from which a pixel counts as clipped: JPEG blurs a plateau at 255 down to 250."""

CHANNELS = ("r", "g", "b")

SPOT_COLUMNS = ["light", "position", "camera", "x", "y", "saturated", "distance"]

Key = tuple[str, str]
"""Ball position and camera."""


def read_ball_photo(
    path: Path, transfer: Transfer = "linear"
) -> tuple[Float32[np.ndarray, "height width channels"], Bool[np.ndarray, "height width"]]:
    """Linear image of one (grey) or three channels, and mask of its clipped pixels.

    In counts over their maximum.

    Raises:
        InputError: if the file cannot be read.
    """
    stored = read_stored(path)
    channels = stored[..., None] if stored.ndim == 2 else stored[..., :3]
    if (channels == channels[..., :1]).all():
        channels = channels[..., :1]
    counted = stored.dtype.kind == "u"
    image = channels.astype(np.float32) / np.float32(np.iinfo(stored.dtype).max if counted else 1)
    clipped = (image >= CLIPPED).any(2) if counted else np.zeros(image.shape[:2], bool)
    return linear_from_srgb(image) if transfer == "srgb" else image, clipped


def use_most_balls(calibration: dict[str, Any], most: int | None) -> dict[str, Any]:
    """calibration_lights.json with at most `most` ball positions.

    Evenly chosen in the order of their names.
    """
    positions = sorted({entry["position"] for entry in calibration["silhouettes"]})
    if most is None or most >= len(positions):
        return calibration
    chosen = {positions[round(k)] for k in np.linspace(0, len(positions) - 1, most)}
    few = {key: [e for e in calibration[key] if e["position"] in chosen] for key in ("images", "silhouettes")}
    return {**calibration, **few}


def find_outlines(
    capture: Path, calibration: dict[str, Any]
) -> tuple[dict[Key, Float64[np.ndarray, "_ 2"]], dict[Key, str]]:
    """Outlines in pixels per position and camera.

    And what the other images hold instead of a ball.
    """
    outlines, refused = {}, {}
    for entry in calibration["silhouettes"]:
        key = entry["position"], entry["camera"]
        gray = read_ball_photo(capture / entry["path"], calibration.get("transfer", "linear"))[0].mean(2)
        if (outline := measure_outline(gray)) is not None:
            outlines[key] = outline
        else:
            refused[key] = why_no_ball(gray)
            log.warning("%s: found %s: left out", entry["path"], refused[key])
    return outlines, refused


def find_spots(
    capture: Path, calibration: dict[str, Any], outlines: dict[Key, np.ndarray], lights: Iterable[str], threads: int
) -> pd.DataFrame:
    """Table of bright spots, one row each.

    `SPOT_COLUMNS`, `flux`, and flux_r, flux_g, flux_b (NaN where the image is grey).
    """
    known = set(lights)
    entries = [e for e in calibration["images"] if (e["position"], e["camera"]) in outlines and e["light"] in known]

    def measure(entry: dict[str, Any]) -> list[Spot]:
        image, clipped = read_ball_photo(capture / entry["path"], calibration.get("transfer", "linear"))
        return measure_spots(image, clipped, outlines[entry["position"], entry["camera"]])

    with ThreadPoolExecutor(threads) as pool:
        found = list(progress(pool.map(measure, entries), "mirror ball images", len(entries)))
    rows = [
        (
            entry["light"], entry["position"], entry["camera"], *spot.pixel, spot.saturated, spot.distance,
            spot.flux.mean(), *(spot.flux if len(spot.flux) == 3 else np.full(3, np.nan)),
        )
        for entry, spots in zip(entries, found, strict=True)
        for spot in spots
    ]  # fmt: skip
    return pd.DataFrame(rows, columns=[*SPOT_COLUMNS, "flux", *(f"flux_{channel}" for channel in CHANNELS)])
