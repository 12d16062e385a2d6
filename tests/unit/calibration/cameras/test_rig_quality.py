"""Numbers that cameras are judged by, on views whose answers are known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.calibration.cameras.image_coverage import covered_share
from pipeline.calibration.cameras.rig_quality import describe_focal, largest_turn


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
