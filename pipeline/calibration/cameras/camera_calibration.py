"""Result of a calibration of cameras, from boards, from features, or given."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import pandas as pd

from pipeline.base.errors import Complaints
from pipeline.base.verdicts import Verdict
from pipeline.calibration.cameras.relative_poses import PAIR_COLUMNS
from pipeline.geometry.cameras import Camera

RESIDUAL_COLUMNS = ["camera", "view", "board", "corner", "x", "y", "residual_x", "residual_y", "weight"]

QUALITY_COLUMNS = [
    "camera", "views", "corners", "rms_px", "focal_sigma", "center_sigma_m", "coverage", "tilt_deg", "distortion",
]  # fmt: skip


@dataclass(frozen=True)
class CameraCalibration:
    """Cameras at sensor resolution, in metres, and how good they are.

    Of features, views are frames, and corners the points of the subject, of one board.

    Attributes:
        residuals: `RESIDUAL_COLUMNS`, a row for each corner; the residual is projected minus observed, pixels.
        quality: `QUALITY_COLUMNS`, a row for each camera.
        pairs: `PAIR_COLUMNS`, a row for every two cameras.
        complaints: what of it must not be used; it is not written if there are any.
    """

    cameras: Mapping[str, Camera]
    residuals: pd.DataFrame
    quality: pd.DataFrame
    pairs: pd.DataFrame
    verdicts: list[Verdict]
    complaints: Complaints


def given_calibration(cameras: Mapping[str, Camera], complaints: Complaints) -> CameraCalibration:
    """Cameras that are given: nothing was measured."""
    residuals, quality, pairs = (
        pd.DataFrame(columns=columns, dtype="float64").astype(dict.fromkeys(names, "str"))
        for columns, names in (
            (RESIDUAL_COLUMNS, ["camera"]), (QUALITY_COLUMNS, ["camera"]), (PAIR_COLUMNS, ["first", "second"]),
        )
    )  # fmt: skip
    verdicts = [Verdict("camera", name, "good", "given, not calibrated here") for name in cameras]
    return CameraCalibration(cameras, residuals, quality, pairs, verdicts, complaints)
