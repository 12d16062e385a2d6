"""Numbers that cameras are judged by, on views whose answers are known."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from pipeline.calibration.cameras.camera_calibration import QUALITY_COLUMNS
from pipeline.calibration.cameras.image_coverage import covered_share
from pipeline.calibration.cameras.rig import Rig
from pipeline.calibration.cameras.rig_calibration import Calibrated, Inspection
from pipeline.calibration.cameras.rig_quality import describe_focal, judge_cameras, largest_turn
from pipeline.config.calibrate_cameras import CalibrateCameras


def test_coverage_is_the_share_of_the_image_that_has_corners():
    """Of a wide image: everywhere, in its left half, in its upper quarter, at one place."""
    x, y = np.meshgrid(np.arange(5.0, 1280, 10), np.arange(5.0, 480, 10))
    pixels = np.stack([x.ravel(), y.ravel()], 1)
    assert covered_share(pixels, 1280, 480) == 1
    assert covered_share(pixels[pixels[:, 0] < 640], 1280, 480) == 0.5
    assert covered_share(pixels[pixels[:, 1] < 120], 1280, 480) == 0.25
    assert covered_share(pixels[:1], 1280, 480) == 1 / 64


def test_largest_turn_is_the_angle_between_boards_in_degrees():
    """Turning a board in its own plane tilts nothing."""
    turns = Rotation.from_euler("YXZ", [[0, 0, 0], [37, 0, 0], [-20, 0, 0], [37, 0, 120]], degrees=True).as_matrix()
    assert largest_turn(turns) == pytest.approx(57)
    assert "parallel" in describe_focal(0.1, largest_turn(turns[:1])) and "parallel" not in describe_focal(0.1, 57.0)


@pytest.mark.parametrize(
    ("known_to", "grade", "said"),
    [(1e-6, "good", "focal length +-0.000 %"), (2.0, "weak", "uncertain"), (10.0, "failed", "uncertain")],
)
def test_camera_is_as_good_as_its_focal_length_is_known(known_to, grade, said):
    """In units of the error that is good; all else is as good as can be."""
    limits = CalibrateCameras(good_focal_error=0.001, largest_focal_error=0.005)
    row = ("a", 99, 9999, 0.01, 0.001 * known_to, 1e-6, 1.0, 60.0, 5)
    quality = pd.DataFrame([row], columns=QUALITY_COLUMNS)
    unseen = Rig.__new__(Rig)  # no verdict but that on lens models looks at it
    calibrated = Calibrated(unseen, [5], [{}], unseen)
    (verdict,) = judge_cameras(quality, calibrated, {"a": []}, Inspection([], {}), ["a"], limits)
    assert verdict.grade == grade and said in verdict.reason
