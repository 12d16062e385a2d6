"""Distances and turns between cameras and their error bars: a closed form, and planted rigs."""

from __future__ import annotations

import itertools
from dataclasses import replace

import cv2
import numpy as np
import pytest
import scipy.stats

from pipeline.calibration.cameras.relative_poses import (
    PAIR_COLUMNS,
    pair_covariance,
    pair_table,
    turn_covariance,
)
from pipeline.calibration.cameras.rig import adjust_rig
from pipeline.calibration.cameras.rig_calibration import Calibrated
from pipeline.calibration.cameras.rig_spread import with_spread
from tests.support.rigs.cameras import BOARD, boards_in_stage, observe, planted_cameras, without_small_views

RIGS, CAMERAS, VIEWS, NOISE_PX = 60, 4, 9, 0.2

LEVEL = 1e-3
"""Probability that right error bars fail one of these tests, if other seeds are drawn."""


def turn_between(a, b):
    return b.R @ a.R.T


def turn_error_deg(found, true):
    return float(np.degrees(np.linalg.norm(cv2.Rodrigues(found @ true.T)[0])))


def test_two_cameras_by_hand():
    """A quarter turn and 3-4-5: the second camera alone is uncertain; then both turn and move as one."""
    one, other = planted_cameras(2, np.random.default_rng(0))
    a = replace(one, R=np.eye(3), t=np.zeros(3))
    R = np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]])
    b = replace(other, R=R, t=-R @ [3.0, 4.0, 0.0])
    second = np.diag([0.0] * 6 + [0.01, 0.02, 0.02, 0.1, 0.0, 0.3]) ** 2
    (row,) = pair_table({"a": a, "b": b}, [second]).to_dict("records")
    assert list(row) == PAIR_COLUMNS and (row["first"], row["second"]) == ("a", "b")
    assert row["baseline_m"] == pytest.approx(5) and row["turn_deg"] == pytest.approx(90)
    # Along (3, 4, 0) / 5 the centre varies by 0.6 * 0.1.
    assert row["baseline_sigma_m"] == pytest.approx(0.06)
    assert row["turn_sigma_deg"] == pytest.approx(np.degrees(np.sqrt((0.01**2 + 2 * 0.02**2) / 3)))
    together = np.kron([[1, 0], [1, 0]], np.eye(6))
    (row,) = pair_table({"a": a, "b": replace(b, R=np.eye(3))}, [together @ together.T]).to_dict("records")
    # Cameras that look the same way and turn and move as one keep their distance and their turn.
    assert row["baseline_sigma_m"] == pytest.approx(0, abs=1e-9) and row["turn_sigma_deg"] == pytest.approx(0, abs=1e-9)


def test_of_two_covariances_the_larger_error_bar_counts():
    cameras = dict(zip("ab", planted_cameras(2, np.random.default_rng(0)), strict=True))
    turn, place = (np.diag(np.tile(np.repeat(sigma, 3), 2)) ** 2 for sigma in ([0.01, 0.0], [0.0, 0.002]))
    (both,) = pair_table(cameras, [turn, place]).to_dict("records")
    alone = [pair_table(cameras, [covariance]).iloc[0] for covariance in (turn, place)]
    assert both["turn_sigma_deg"] == pytest.approx(alone[0].turn_sigma_deg) and alone[1].turn_sigma_deg < 1e-6
    assert both["baseline_sigma_m"] == pytest.approx(alone[1].baseline_sigma_m) and alone[0].baseline_sigma_m < 1e-9


@pytest.fixture(scope="module")
def rigs():
    """Calibrated rigs, their true cameras, and the pairs with error bars before and after the spread."""
    found = []
    for seed in range(RIGS):
        random = np.random.default_rng(seed)
        planted = planted_cameras(CAMERAS, random, arc=1.4)
        cameras = [replace(camera, dist=camera.dist * [1, 1, 0, 0, 0]) for camera in planted]
        boards = boards_in_stage(VIEWS, random, arc=1.4)
        seen, numbers = without_small_views(observe(cameras, boards, NOISE_PX, random))
        boards = boards[numbers]
        start = [replace(c, R=c.R @ boards[0][:3, :3], t=c.R @ boards[0][:3, 3] + c.t) for c in cameras]
        rig = adjust_rig(seen, BOARD.corners_m(), start, np.linalg.inv(boards[0]) @ boards, 2)
        wider = with_spread(Calibrated(rig, [2] * CAMERAS, [{}] * CAMERAS, rig), np.arange(len(boards))).rig
        named = {f"cam{c}": camera for c, camera in enumerate(rig.cameras)}
        found.append((rig, cameras, pair_table(named, rig.pose_covariances), pair_table(named, wider.pose_covariances)))
    return found


def test_errors_of_relative_turns_and_baselines_are_as_large_as_their_error_bars(rigs):
    """Neighbouring cameras of planted rigs: three angles and a distance per rig; rigs are independent of each other."""
    turns, lengths = [], []
    for rig, cameras, pairs, _ in rigs:
        row = pairs.iloc[0]
        error = cv2.Rodrigues(turn_between(*rig.cameras[:2]) @ turn_between(*cameras[:2]).T)[0].ravel()
        # Against the whole covariance: the axes of a turn are not alike.
        pair = pair_covariance(rig.pose_covariances[0], 0, 1)
        covariance = turn_covariance(turn_between(*rig.cameras[:2]), pair)
        turns.append(error @ np.linalg.solve(covariance, error))
        apart = [np.linalg.norm(two[0].center - two[1].center) for two in (rig.cameras, cameras)]
        lengths.append(((apart[0] - apart[1]) / row.baseline_sigma_m) ** 2)
    for squared, degrees in ((turns, 3), (lengths, 1)):
        low, high = scipy.stats.chi2.ppf([LEVEL / 2, 1 - LEVEL / 2], RIGS * degrees)
        assert low < sum(squared) < high
        assert scipy.stats.kstest(squared, scipy.stats.chi2(degrees).cdf).pvalue > LEVEL


def test_of_independent_errors_the_spread_leaves_error_bars_nearly_as_they_are(rigs):
    ratios = [wide.turn_sigma_deg / own.turn_sigma_deg for _, _, own, wide in rigs]
    assert np.min(ratios) > 1 - 1e-9 and np.median(ratios) < 1.25


def test_angles_of_all_pairs_hold_the_true_ones(rigs):
    """Of 60 rigs' six pairs, sizes over error bars: the root mean square of what goes together in a rig."""
    over = [
        turn_error_deg(turn_between(rig.cameras[a], rig.cameras[b]), turn_between(cameras[a], cameras[b]))
        / (np.sqrt(3) * row.turn_sigma_deg)
        for rig, cameras, _, wide in rigs
        for (a, b), row in zip(itertools.combinations(range(CAMERAS), 2), wide.itertuples(), strict=True)
    ]
    # As if each rig were one number, which it is not: a factor of 1.35 either way.
    assert 0.75 < np.sqrt(np.mean(np.square(over))) < 1.35
