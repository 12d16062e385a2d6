"""Settings of the calibration of the lights."""

from __future__ import annotations

from pydantic import Field

from pipeline.config.settings import Settings

LARGEST_CAMERA_SHIFT_M = 0.005
"""Two calibrations of one rig agree to well below a millimetre; lights are known to 3 or 4."""


class CalibrateLights(Settings):
    """Location of lights from their highlights in a mirror ball.

    Bounds of the grades: a light at 2.4 m that is off by 10 mm turns its direction by a quarter of a degree, which no
    shading shows; by 30 mm, as much as a survey is off, and then the survey is as good. An outline in a sharp linear
    image leaves 0.06 px; ten times that is a wrong radius, a stand in the way or a curve that was not undone. Three
    centimetres per metre are more than a survey good to centimetres is off, and less than a board printed at 95 %.
    """

    most_balls: int | None = Field(
        None, ge=1, description="Ball positions used, evenly chosen by name; null: all of them [positions]"
    )
    least_highlights: int = Field(
        3, ge=2, description="Highlights without which a light keeps its surveyed position [highlights]"
    )
    weak_sigma_m: float = Field(
        0.01, gt=0, description="Standard deviation per axis above which a light is called weak [m]"
    )
    largest_sigma_m: float = Field(
        0.03, gt=0, description="Standard deviation per axis above which a light keeps its surveyed position [m]"
    )
    suspicious_distance_m: float = Field(
        0.25, gt=0, description="Distance from a light's surveyed position from which names may be mixed up [m]"
    )
    largest_camera_shift_m: float = Field(
        LARGEST_CAMERA_SHIFT_M, gt=0, description="Shift since lights were calibrated up to which a camera stayed [m]"
    )
    weak_outline_px: float = Field(
        0.6, gt=0, description="Root mean square of an outline's residual above which a ball is called weak [px]"
    )
    largest_scale_error: float = Field(
        0.03, gt=0, description="Relative difference in size of board, ball and survey that is no other unit [-]"
    )
    farthest_for_flux: float = Field(
        0.9, gt=0, le=1, description="Distance from the ball's middle to which highlights tell brightness [radii]"
    )
