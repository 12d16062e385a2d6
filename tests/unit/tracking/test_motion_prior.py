"""Costs of motions and keypoints that are known on paper: accelerations, cuts, and units of the noise."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.geometry.kinematics import Pose, TrackedPoints, tracked_points
from pipeline.geometry.template_file import read_template
from pipeline.tracking.motion_prior import DECORRELATION_S, MotionPrior, prior_cost
from pipeline.tracking.pose_solver import reprojection_term
from tests.support.figures.walking import ring_of_cameras, write_template

TRANSLATION_SIGMA = 20.0
"""m/s^2."""


@pytest.fixture
def points(tmp_path: Path) -> TrackedPoints:
    template = read_template(write_template(tmp_path / "t.glb", units_per_m=100.0), 0.01)
    return tracked_points(template, np.array([0]), np.array([-1]))


def at_rest_along(points: TrackedPoints, path: np.ndarray) -> Pose:
    """The rest pose, moved along a path [frames, 3] without a turn."""
    rest = points.rest_pose(len(path))
    return replace(rest, root_translation=rest.root_translation + path)


def prior_of(times: np.ndarray, takes: np.ndarray | None = None) -> MotionPrior:
    return MotionPrior(times, 5.0, TRANSLATION_SIGMA, 0.7, takes=takes)


@pytest.mark.parametrize("steps", [[0.1] * 6, [0.04, 0.1, 0.05, 0.2, 0.06, 0.15], [0.25, 0.05, 0.05, 0.25]])
def test_constant_acceleration_costs_what_it_lasts_at_any_spacing(points: TrackedPoints, steps: list) -> None:
    """A fall: half of (g / sigma)^2 for each decorrelation time between the middles of the first and last step."""
    times = np.cumsum([0.0, *steps])
    fall = 0.5 * times[:, None] ** 2 * np.array([0.0, -9.81, 0.0])
    lasts = times[-1] - (steps[0] + steps[-1]) / 2
    expected = 0.5 * (9.81 / TRANSLATION_SIGMA) ** 2 * lasts / DECORRELATION_S
    assert prior_cost(prior_of(times), points, at_rest_along(points, fall)) == pytest.approx(expected, rel=1e-9)


def test_jump_between_takes_costs_nothing_and_within_one_much(points: TrackedPoints) -> None:
    times = np.arange(8) / 25
    path = np.outer(times, [1.0, 0.0, 0.3])
    path[4:] += [2.0, 0.0, 0.0]
    pose, takes = at_rest_along(points, path), np.array([0, 0, 0, 0, 1, 1, 1, 1])
    assert prior_cost(prior_of(times, takes), points, pose) < 1e-12
    assert prior_cost(prior_of(times, np.zeros(8, np.int64)), points, pose) > 1e3


def test_keypoint_twice_as_far_under_twice_the_noise_costs_the_same() -> None:
    """Costs are those of residuals in standard deviations; confidence counts as a number of keypoints."""
    (camera,) = list(ring_of_cameras(6).values())[:1]
    where = camera.center + 3.0 * camera.R[2]
    seen = np.zeros((1, 1, 1, 2))  # the principal point, in normalised coordinates
    confidence = np.ones((1, 1, 1))

    def cost(aside_m: float, sigma_px: float) -> float:
        place = (where + aside_m * camera.R[0])[None, None]
        return reprojection_term([camera], seen, confidence, sigma_px)(place).cost

    assert cost(0.0, 2.0) == pytest.approx(0, abs=1e-12)
    assert cost(0.02, 4.0) == pytest.approx(cost(0.01, 2.0), rel=1e-9)
    assert cost(0.01, 2.0) > cost(0.01, 4.0) > 0
