"""Cameras that stand upright in a world of any up axis are turned so that y is up."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.datasets.up_axis import TURNS, turned, upright_from_set
from pipeline.geometry.cameras import Camera
from tests.support.datasets.turning_head import looking_at


def ring(turn: np.ndarray) -> list[Camera]:
    """Cameras round the origin of a world with y up, in a world turned by `turn`."""
    places = [np.array([np.sin(a), 0.4 * (-1) ** k, np.cos(a)]) for k, a in enumerate((-1.0, -0.3, 0.4, 1.1))]
    poses = [looking_at(place, np.zeros(3)) for place in places]
    return [Camera(R @ turn.T, t, np.eye(3), np.zeros(5), 8, 8) for R, t in poses]


@pytest.mark.parametrize("name", list(TURNS))
def test_every_axis_is_found(name):
    upright = np.array(TURNS[name], np.float64)
    axis = "xyz".index(name[1])
    assert np.linalg.det(upright) == pytest.approx(1)
    np.testing.assert_allclose(upright[:, axis] * (1 if name[0] == "+" else -1), [0, 1, 0])
    cameras = ring(upright.T)
    np.testing.assert_allclose(upright_from_set(cameras, "set"), upright)
    for camera, expected in zip(cameras, ring(np.eye(3)), strict=True):
        np.testing.assert_allclose(turned(camera, upright).R, expected.R, atol=1e-12)


def test_a_world_at_an_angle_is_refused():
    c, s = np.cos(np.pi / 4), np.sin(np.pi / 4)
    with pytest.raises(InputError, match="near an axis"):
        upright_from_set(ring(np.array([[1, 0, 0], [0, c, -s], [0, s, c]])), "set")
