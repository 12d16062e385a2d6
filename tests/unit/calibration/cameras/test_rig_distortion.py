"""Which distortion model is chosen for corners that OpenCV projects through lenses of 0, 1, 2 and 5 coefficients."""

import numpy as np
import pytest

from pipeline.calibration.cameras.rig_calibration import calibrate_rig
from pipeline.calibration.cameras.rig_quality import wanted_distortion
from pipeline.geometry.cameras import Camera
from pipeline.geometry.lenses import BROWN_CONRADY
from tests.support.rigs.cameras import BOARD, SIZE, boards_in_stage, observe, planted_cameras, without_small_views

LENSES = {
    0: [0, 0, 0, 0, 0],
    1: [-0.3, 0, 0, 0, 0],
    2: [-0.4, 0.9, 0, 0, 0],
    5: [-0.25, 0.3, 6e-3, -5e-3, -0.4],
}
"""Where corners reach, r = 0.45 of 700 px, each further term moves them by many standard deviations (0.05 px)."""


def calibrate(lenses, seed=3, distortion="auto"):
    rng = np.random.default_rng(seed)
    planted = planted_cameras(len(lenses), rng, arc=1.5)
    cameras = [Camera(c.R, c.t, c.K, np.array(d, float), *SIZE) for c, d in zip(planted, lenses, strict=True)]
    boards = boards_in_stage(16, rng, arc=1.5)
    observations, _ = without_small_views(observe(cameras, boards, 0.05, rng))
    return calibrate_rig(observations, BOARD.corners_m(), [SIZE] * len(lenses), distortion), cameras


@pytest.mark.parametrize("number", [0, 1, 2, 5])
def test_the_model_that_made_the_data_is_chosen(number):
    chosen = []
    for seed in (3, 4):
        calibrated, cameras = calibrate([LENSES[number]] * 3, seed)
        chosen += calibrated.distortion
        rig = calibrated.rig
        for c, (found, true) in enumerate(zip(rig.cameras, cameras, strict=True)):
            assert rig.focal_sigma[c] < 2e-3
            assert abs(found.K[0, 0] / true.K[0, 0] - 1) < 4 * rig.focal_sigma[c]
            assert np.all(found.dist[calibrated.distortion[c] :] == 0)
    # A term too many, now and then, costs a little precision and no truth; a term too few would.
    assert min(chosen) == number
    assert chosen.count(number) >= 5


def test_too_few_coefficients_on_request_are_told():
    """Lenses of none and one, both taken for none: the second alone needs more."""
    calibrated, _ = calibrate([LENSES[0], LENSES[1], LENSES[0]], distortion=0)
    assert calibrated.distortion == [0, 0, 0]
    assert [wanted_distortion(calibrated, c) for c in range(3)] == [0, 1, 0]


def test_each_camera_of_a_rig_has_its_own_model():
    calibrated, _ = calibrate([LENSES[0], LENSES[5], LENSES[2]])
    assert calibrated.distortion == [0, 5, 2]


def test_terms_too_small_to_be_seen_are_left_out_and_cost_nothing():
    """k2, p1 and p2 that move no corner by more than 0.02 px: fewer terms, and focal lengths inside their bars."""
    calibrated, cameras = calibrate([[-0.3, 1e-3, 1e-5, -1e-5, 0]] * 3)
    assert max(calibrated.distortion) < 5
    for found, true, sigma in zip(calibrated.rig.cameras, cameras, calibrated.rig.focal_sigma, strict=True):
        assert abs(found.K[0, 0] / true.K[0, 0] - 1) < 4 * sigma


def test_the_odds_of_one_coefficient_by_hand():
    """The density ratio of k1 = 0 for a lens of one coefficient against none, from the two normal densities."""
    calibrated, _ = calibrate([LENSES[1]] * 3)
    odds = calibrated.evidence[0]
    assert odds[5] == 0
    assert odds[1] > 0 > odds[0]  # the terms beyond k1 are not supported, k1 is
    sigma = np.sqrt(calibrated.rig.intrinsics_covariance[0, 4, 4])
    at_zero = -0.5 * (calibrated.rig.cameras[0].dist[0] / sigma) ** 2 + np.log(BROWN_CONRADY.prior_sigma[0] / sigma)
    # The ratio of the ratios is that of k1 alone, up to what the excluded terms change in k1's posterior.
    assert odds[0] - odds[1] == pytest.approx(at_zero, rel=0.15)
