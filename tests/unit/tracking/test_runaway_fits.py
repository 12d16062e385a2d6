"""Fits that run away are said as such."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.tracking.cues import require_finite


def test_vertices_that_ran_away_are_the_keypoints_fault() -> None:
    vertices = np.zeros((2, 3, 3))
    assert require_finite(vertices) is vertices
    vertices[1, 2, 0] = np.nan
    with pytest.raises(InputError, match="keypoints_2d: x, y: expected keypoints that the template can follow"):
        require_finite(vertices)
