"""Settings of the calibration of the cameras."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from pipeline.config.settings import Settings

BOARD_METHODS = ("boards", "charuco")
"""Of `calibration.cameras.method` in capture.yaml: by photographs of boards."""


class CalibrateCameras(Settings):
    """Calibration of cameras from images of boards or of the subject, and its grades.

    A camera counts as good, weak or failed.
    """

    distortion: Literal["auto", 0, 1, 2, 4, 5] = Field(
        "auto",
        description="Distortion coefficients estimated: none, k1, k1 k2, or k1 k2 p1 p2 k3 (5; fisheye: k1 k2 k3 k4, 4)"
        "; auto: for each camera as many as its views support [coefficients]",
    )
    # A lens that was focused or zoomed anew differs by about as much.
    given_lens_error: float = Field(
        0.01,
        gt=0,
        description="With intrinsics: refine, standard deviation of the given focal lengths over themselves; principal "
        "points are known to as many pixels, distortion to a tenfold share of that of ordinary lenses",
    )
    most_views: int | None = Field(
        None,
        ge=1,
        description="Views used, evenly spread over those recorded; of views with times, those where the board rests; "
        "null: all of them [views]",
    )
    # Each has its own points; beyond some, error bars fall by their root, and time rises with their number.
    feature_moments: int = Field(
        8,
        ge=1,
        description="Of method features: fully lit frames that are searched for features, evenly spread [frames]",
    )
    # Three views give Zhang's method all intrinsics.
    least_views: int = Field(3, ge=1, description="Views of a board without which a camera has failed [views]")
    # A bad view among five still shows as one; among fewer it bends all.
    good_views: int = Field(5, ge=1, description="Views of a board from which on a camera is good [views]")
    # 1 % of a body's 1.8 m is 2 cm: larger than what a template forgives.
    largest_focal_error: float = Field(
        0.01, gt=0, description="Standard deviation of a focal length, over itself, above which a camera has failed"
    )
    # 0.2 % of 1.8 m is 4 mm, the thickness of clothing.
    good_focal_error: float = Field(
        0.002, gt=0, description="Standard deviation of a focal length, over itself, up to which a camera is good"
    )
    # At a light stage's 2.5 m, rays that pass each other at 5 mm do so at 0.1 degrees: pixels, not fractions of one.
    good_center_m: float = Field(
        0.005, gt=0, description="Standard deviation of a centre within the rig up to which a camera is good [m]"
    )
    # A detector's worst, on sharp images, is a quarter of this.
    good_rms_px: float = Field(0.5, gt=0, description="Reprojection error up to which a camera is good [px]")
    # Outside its corners a lens is extrapolated; a board of half the image's width in ten places covers half.
    good_coverage: float = Field(
        0.25, ge=0, le=1, description="Share of the cells of an 8 x 8 grid with corners from which on a camera is good"
    )
    # Below, a movement is no worse than the reprojection error of a good camera.
    largest_shift_px: float = Field(
        0.5, gt=0, description="Shift of a camera's corners from some view on, above which it was knocked: failed [px]"
    )
    # Light stages are rooms; millimetres taken for metres make them kilometres.
    largest_rig_m: float = Field(
        50.0, gt=0, description="Distance of a camera from a board above which the board's unit must be wrong [m]"
    )
