"""Settings of the calibration of the cameras."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from pipeline.config.settings import Settings


class CalibrateCameras(Settings):
    """How cameras are calibrated from images of a ChArUco board."""

    distortion: Literal[0, 1, 2, 5] = Field(
        5, description="Distortion coefficients estimated: none, k1, k1 k2, or k1 k2 p1 p2 k3 [coefficients]"
    )
    least_views: int = Field(3, ge=1, description="Views of the board without which a camera is refused [views]")
    largest_focal_error: float = Field(
        0.01, gt=0, description="Standard deviation of a focal length, over itself, above which a camera is refused"
    )
    good_rms_px: float = Field(0.5, gt=0, description="Reprojection error up to which the log calls a camera good [px]")
