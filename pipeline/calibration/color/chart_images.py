"""Images of charts as they are stored, raw mosaics among them, and their sensors' linearity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float32

from pipeline.base.color import linear_from_srgb
from pipeline.base.errors import InputError
from pipeline.calibration.color.chart_layout import CLASSIC, ChartLayout
from pipeline.calibration.color.color_chart import Patches, find_chart, measure_patches, place_chart
from pipeline.calibration.color.sensor_linearity import Linearity, looked_at, measure_linearity
from pipeline.capture.archives import read_bytes
from pipeline.capture.images import BlackLevel, Transfer, decode_image, decode_stored
from pipeline.capture.mosaic import Mosaic, spread_cells
from pipeline.config.calibrate_color import CalibrateColor


@dataclass(frozen=True)
class ChartFormat:
    """Format in which images of charts store light.

    Attributes:
        transfer: how stored values relate to light.
        black_level: stored value of no light.
        mosaic: colours of a raw mosaic's pixels; None: images have three channels.
    """

    transfer: Transfer
    black_level: BlackLevel
    mosaic: Mosaic | None = None

    @classmethod
    def from_index(cls, calibration: Mapping[str, Any], images_black_level: BlackLevel) -> ChartFormat:
        """The format that calibration_color.json describes.

        The black level is that of the subject's images where it says none.
        """
        own = calibration.get("black_level")
        return cls(
            calibration["transfer"], images_black_level if own is None else float(own), calibration.get("mosaic")
        )

    def read(self, path: Path) -> Float32[np.ndarray, "h w 3"]:
        """An image of a chart as linear RGB, at the size it is stored in."""
        content = read_bytes(path)
        if self.mosaic is None:
            return decode_image(content, path, self.transfer, self.black_level)
        stored = decode_stored(content, path)
        light = (spread_cells(stored, self.mosaic, path) - np.float32(self.black_level)) / np.float32(
            full_scale(stored)
        )
        return linear_from_srgb(light) if self.transfer == "srgb" else light


def full_scale(stored: np.ndarray) -> float:
    """Largest count that an image can store; 1 for floats."""
    return float(np.iinfo(stored.dtype).max) if stored.dtype.kind == "u" else 1.0


@dataclass(frozen=True)
class MeasuredChart:
    """Chart as one image shows it.

    Attributes:
        patches: None if no chart was found.
        saturated_share: of all pixels.
    """

    patches: Patches | None
    saturated_share: float


def measure_chart(
    path: Path, form: ChartFormat, corners: list[list[float]] | None, limit: float, settings: CalibrateColor,
    layout: ChartLayout = CLASSIC,
) -> MeasuredChart:  # fmt: skip
    """Find the chart in an image, unless its corners (pixels) are given; measure its patches.

    Args:
        limit: stored value from which the sensor is not linear; NaN if that is not known.
        layout: of the chart; only the classic one is found without corners.
    """
    image = form.read(path)
    saturated = saturated_pixels(decode_stored(read_bytes(path), path), limit, settings)
    saturated = saturated[: image.shape[0], : image.shape[1]]
    squares = find_chart(image) if corners is None else place_chart(np.array(corners, np.float64), layout)
    patches = None if squares is None else measure_patches(image, saturated, squares, settings.patch_interior, layout)
    return MeasuredChart(patches, float(saturated.mean()))


def saturated_pixels(stored: np.ndarray, limit: float, settings: CalibrateColor) -> Bool[np.ndarray, "h w"]:
    """Pixels of which some channel is clipped or no longer linear."""
    highest = float(np.nanmin([settings.saturation * full_scale(stored), limit]))
    return (stored >= highest).any(-1) if stored.ndim == 3 else stored >= highest


def read_linearity(
    capture: Path, entries: Sequence[Mapping[str, Any]], form: ChartFormat, tolerance: float
) -> Linearity | None:
    """Linearity of a sensor from a series of exposures of one scene.

    One image is in memory at a time, and of all those pixels that are looked at.

    Args:
        entries: path and exposure_s of each image.

    Raises:
        InputError: if images cannot be read or differ in size.
    """
    kinds, counts, brightest = set(), [], []
    for entry in entries:
        image = decode_stored(read_bytes(capture / entry["path"]), capture / entry["path"])
        kinds.add(f"{image.shape} {image.dtype}")
        # A copy: a view would keep the whole image.
        counts.append(looked_at(image.ravel()).astype(np.float64))
        brightest.append(full_scale(image) if image.dtype.kind == "u" else float(image.max()))
    if len(kinds) > 1:
        raise InputError(
            f"{capture / entries[0]['path']}: expected images of one size and depth in a series of exposures, found "
            f"{' and '.join(sorted(kinds))}"
        )
    seconds = np.array([entry["exposure_s"] for entry in entries], np.float64)
    black_level, full = float(np.mean(form.black_level)), float(np.max(brightest))
    return measure_linearity(np.stack(counts), seconds, black_level, full, tolerance)
