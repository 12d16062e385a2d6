"""Reported standard deviations against the spread of the errors of 100 synthetic rigs."""

import numpy as np
import pytest
import scipy.stats

from pipeline.calibration.cameras.rig import adjust_rig, robust_inflation
from pipeline.geometry.cameras import Camera
from tests.support.rigs.cameras import (
    BOARD,
    boards_in_stage,
    center_errors,
    observe,
    planted_cameras,
    without_small_views,
)

RIGS, CAMERAS, VIEWS = 100, 4, 9
NOISE_PX = 0.2

LEVEL = 1e-3
"""Probability that right error bars fail one of these tests, if other seeds are drawn. Power of the sums of squares:
error bars wrong by a factor of 1.15 either way are found with 70 to 78 % (focal lengths, 400 degrees of freedom) and
93 to 95 % (centres, 600), by 1.2 with 96 and 99.9 %. A tenth, which the weighted normal matrix alone is off, has a
test of its own."""


def in_first_view(camera, world_from_board):
    """A camera in the frame of a board: where the adjustment starts, so that no test depends on the start."""
    R = camera.R @ world_from_board[:3, :3]
    t = camera.R @ world_from_board[:3, 3] + camera.t
    return Camera(R, t, camera.K, camera.dist, camera.width, camera.height)


@pytest.fixture(scope="module")
def normalized_errors():
    """Squared errors over their covariance: of the focal lengths together, and of the shape of the centres."""
    focal, centers = [], []
    for seed in range(RIGS):
        rng = np.random.default_rng(seed)
        planted = planted_cameras(CAMERAS, rng, arc=1.4)
        cameras = [Camera(c.R, c.t, c.K, c.dist * [1, 1, 0, 0, 0], c.width, c.height) for c in planted]
        boards = boards_in_stage(VIEWS, rng, arc=1.4)
        observations, numbers = without_small_views(observe(cameras, boards, NOISE_PX, rng))
        boards = boards[numbers]
        start = [in_first_view(camera, boards[0]) for camera in cameras]
        rig = adjust_rig(observations, BOARD.corners_m(), start, np.linalg.inv(boards[0]) @ boards, 2)
        at = np.searchsorted(rig.model.free, np.arange(CAMERAS) * rig.model.intrinsics_count)
        joint = rig.normal_inverse[np.ix_(at, at)]
        correlation = joint / np.sqrt(np.outer(np.diag(joint), np.diag(joint)))
        error = np.array([found.K[0, 0] / true.K[0, 0] - 1 for found, true in zip(rig.cameras, cameras, strict=True)])
        focal.append(error / rig.focal_sigma @ np.linalg.solve(correlation, error / rig.focal_sigma))
        value, vector = np.linalg.eigh(rig.center_covariance)
        assert np.all(value[:6] < 1e-6 * value[6])  # no rigid motion is left in it
        component = vector[:, 6:].T @ center_errors(rig.cameras, cameras).ravel()
        centers.append((component**2 / value[6:]).sum())
    return {"focal": (np.array(focal), CAMERAS), "centers": (np.array(centers), 3 * CAMERAS - 6)}


@pytest.mark.parametrize("which", ["focal", "centers"])
def test_errors_have_the_predicted_size(normalized_errors, which):
    squared, degrees = normalized_errors[which]
    low, high = scipy.stats.chi2.ppf([LEVEL / 2, 1 - LEVEL / 2], RIGS * degrees)
    assert low < squared.sum() < high


@pytest.mark.parametrize("which", ["focal", "centers"])
def test_errors_have_the_predicted_distribution(normalized_errors, which):
    """Kolmogorov and Smirnov's test sees what a sum does not: bars too wide for some rigs, too narrow for others."""
    squared, degrees = normalized_errors[which]
    assert scipy.stats.kstest(squared, scipy.stats.chi2(degrees).cdf).pvalue > LEVEL


def test_the_robust_fit_is_no_better_than_it_is():
    """Fitting a mean with Cauchy's loss: the spread of the estimate over what the weights claim, by simulation."""
    rng = np.random.default_rng(0)
    draws = rng.normal(size=(4000, 200, 2))
    mean = np.zeros((4000, 1, 2))
    for _ in range(30):
        weight = 1 / (1 + ((draws - mean) ** 2).sum(-1, keepdims=True) / 2.3849**2)
        mean = (weight * draws).sum(1, keepdims=True) / weight.sum(1, keepdims=True)
    claimed = 1 / weight.sum(1).mean()
    inflation = np.mean([robust_inflation(each - m, 2) for each, m in zip(draws[:50], mean[:50], strict=True)])
    # 8000 numbers: their variance is known to 1.6 %; four standard deviations.
    assert mean.var() / claimed == pytest.approx(inflation, rel=0.065)
