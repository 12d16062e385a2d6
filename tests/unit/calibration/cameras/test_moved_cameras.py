"""Cameras that are turned or shifted between two views, on corners that OpenCV projects."""

import cv2
import numpy as np
import pytest
from scipy.stats import chi2

from pipeline.calibration.cameras import moved_cameras
from pipeline.calibration.cameras.moved_cameras import find_moved
from pipeline.calibration.cameras.rig_calibration import calibrate_rig, inspect_rig
from pipeline.calibration.cameras.rig_inputs import Observations
from pipeline.geometry.cameras import Camera
from tests.support.rigs.cameras import BOARD, SIZE, boards_in_stage, observe, planted_cameras, without_small_views

COUNT, VIEWS = 4, 16


def turned(camera, degrees, shift_m=0.0):
    """The camera turned about its own y axis, and moved sideways."""
    R = cv2.Rodrigues(np.radians([0.0, degrees, 0.0]))[0] @ camera.R
    return Camera(R, -R @ (camera.center + shift_m * camera.R[0]), camera.K, camera.dist, *SIZE)


def record(moves, noise=0.1, seed=5, count=COUNT):
    """Observations and view numbers; `moves`: {camera: (first view after, degrees, metres)}."""
    rng = np.random.default_rng(seed)
    cameras = planted_cameras(count, rng, arc=1.2)
    boards = boards_in_stage(VIEWS, rng, arc=1.2)
    parts = []
    for v in range(VIEWS):
        now = [turned(c, *moves[k][1:]) if k in moves and v >= moves[k][0] else c for k, c in enumerate(cameras)]
        seen = observe(now, boards[v : v + 1], noise, rng)
        parts.append(Observations(seen.camera, seen.view + v, seen.corner, seen.pixel))
    joined = [np.concatenate([getattr(p, key) for p in parts]) for key in ("camera", "view", "corner", "pixel")]
    return without_small_views(Observations(*joined))


def first_seen(moves, camera, **options):
    """The first view that a camera sees after it moved."""
    observations, numbers = record(moves, **options)
    seen = numbers[observations.view[observations.camera == camera]]
    return seen[seen >= moves[camera][0]].min()


def movements(moves, **options):
    observations, numbers = record(moves, **options)
    count = options.get("count", COUNT)
    calibrated = calibrate_rig(observations, BOARD.corners_m(), [SIZE] * count, "auto")
    return inspect_rig(calibrated, BOARD.corners_m(), [SIZE] * count, numbers).movements


@pytest.mark.parametrize("seed", range(5))
def test_a_rig_that_stands_still_is_not_suspected(seed):
    assert movements({}, seed=seed) == []


@pytest.mark.parametrize(
    ("degrees", "shift_m"),
    [(0.02, 0.0), (0.1, 0.002), (1.0, 0.0), (10.0, 0.05)],
    ids=["0.3 px", "2 px", "12 px", "100 px"],
)
def test_a_moved_camera_is_named_with_its_view(degrees, shift_m):
    moves = {2: (9, degrees, shift_m)}
    found = movements(moves)
    assert [(m.suspects, m.shot) for m in found] == [([2], first_seen(moves, 2))]
    # Direction and place of a camera that sees a board 2.5 m away trade 0.02 degrees for a millimetre, and 0.1 px leave
    # one millimetre open.
    assert found[0].turn_deg == pytest.approx(degrees, rel=0.02, abs=0.05)
    assert found[0].shift_m == pytest.approx(shift_m, abs=5e-3)


def test_two_moved_cameras_are_both_named():
    moves = {0: (6, 0.5, 0.0), 3: (11, -0.7, 0.01)}
    assert sorted((m.suspects[0], m.shot) for m in movements(moves)) == [(c, first_seen(moves, c)) for c in (0, 3)]


def test_of_two_cameras_either_may_have_moved():
    moves = {1: (8, 0.5, 0.01)}
    found = movements(moves, count=2)
    assert [(sorted(m.suspects), m.shot) for m in found] == [([0, 1], first_seen(moves, 1, count=2))]


def test_a_camera_alone_cannot_have_moved():
    """Boards follow the only camera wherever it goes: there is nothing to see, and nothing to suspect."""
    observations, numbers = record({0: (5, 3.0, 0.1)}, count=1)
    calibrated = calibrate_rig(observations, BOARD.corners_m(), [SIZE], "auto")
    assert find_moved(calibrated.rig, numbers) is None


@pytest.mark.parametrize(("places", "suspected"), [(1, True), (3, True), (5, False), (1000, False)])
def test_one_in_a_million_is_the_chance_of_any_alarm_not_of_one_place(monkeypatch, places, suspected):
    """Bonferroni: a gain that noise has once in four million times, at one of so many places to look at."""
    observations, numbers = record({}, count=2)
    rig = calibrate_rig(observations, BOARD.corners_m(), [SIZE] * 2, "auto").rig

    def planted(rig, camera, time):
        sizes = [chi2.isf(0.25e-6, 6)] + [1.0] * (places - 1)
        return [(k, moved_cameras._Gain(float(size), 6, 0.0, 0, 0.1)) for k, size in enumerate(sizes) if camera == 1]

    monkeypatch.setattr(moved_cameras, "_gains", planted)
    found = find_moved(rig, numbers)
    assert (found is not None) == suspected
    assert not suspected or (found.suspects, found.time) == ([1], 0)
