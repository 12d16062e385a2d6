"""How often a knocked camera is noticed, and how often one is accused that stood still: counted over planted rigs.

`pytest -s` prints the counts. The lenses bend more than the model that judges them can, the board is carried around the
stage, so that what the lens leaves over changes with time as a movement would, and cameras have as few as five views.
"""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pipeline.calibration.cameras.moved_cameras import find_moved
from pipeline.calibration.cameras.rig_calibration import calibrate_rig, inspect_rig
from pipeline.calibration.cameras.rig_inputs import Observations
from pipeline.geometry.cameras import Camera
from tests.support.rigs.cameras import BOARD, SIZE, boards_in_stage, observe, planted_cameras, without_small_views

CAMERAS, RIGS = 3, 10


def record(seed, views, degrees=0.0, shift_m=0.0):
    """Observations and view numbers; camera 1 is knocked halfway."""
    rng = np.random.default_rng(seed)
    cameras = planted_cameras(CAMERAS, rng, arc=1.2)
    bent = rng.uniform(-0.36, -0.24, CAMERAS)
    cameras = [Camera(c.R, c.t, c.K, np.array([k1, 0.1, 0, 0, 0]), *SIZE) for c, k1 in zip(cameras, bent, strict=True)]
    boards = boards_in_stage(views, rng, arc=1.2)
    boards = boards[np.argsort(np.arctan2(-boards[:, 0, 2], -boards[:, 2, 2]))]
    old = cameras[1]
    R = cv2.Rodrigues(np.radians([0.0, degrees, 0.0]))[0] @ old.R
    knocked = [*cameras]
    knocked[1] = Camera(R, -R @ (old.center + shift_m * old.R[0]), old.K, old.dist, *SIZE)
    before = observe(cameras, boards, 0.1, rng)
    after = observe(knocked, boards, 0.1, rng)
    early, late = before.select(before.view < views // 2), after.select(after.view >= views // 2)
    parts = [np.concatenate([getattr(p, key) for p in (early, late)]) for key in ("camera", "view", "corner", "pixel")]
    return without_small_views(Observations(*parts))


def judge(seed, views, distortion, **knock):
    observations, numbers = record(seed, views, **knock)
    calibrated = calibrate_rig(observations, BOARD.corners_m(), [SIZE] * CAMERAS, distortion)
    movements = inspect_rig(calibrated, BOARD.corners_m(), [SIZE] * CAMERAS, numbers).movements
    return calibrated.rig, numbers, [movement.suspects for movement in movements]


@pytest.mark.parametrize("views", [7, 12])
def test_no_lens_misfit_is_taken_for_a_movement(views):
    """What no coefficients leave over is larger than a knock of 2 mm, and no camera is accused of it.

    Judged by those very lenses, the other differences between views speak against a movement, though not always:
    counted as well.
    """
    misfit, alarms, worst = [], 0, 0
    for seed in range(RIGS):
        rig, numbers, accused = judge(seed, views, 0)
        misfit.append(np.sqrt((rig.residual**2).sum(1).mean()))
        alarms += bool(accused)
        worst += find_moved(rig, numbers) is not None
    print(f"\n{views} views, misfit {np.mean(misfit):.2f} px: {alarms} of {RIGS} accused, {worst} by such lenses")
    assert np.mean(misfit) > 0.3  # of which noise is 0.14
    assert alarms == 0
    # Where only noise is allowed for, it is four of ten with seven views, and nine of ten with twelve.
    assert worst <= 1


@pytest.mark.parametrize(
    ("degrees", "shift_m"), [(0.1, 0.002), (1.0, 0.01)], ids=["2 mm and 0.1 deg", "1 cm and 1 deg"]
)
def test_knocks_are_found_whatever_the_lens(degrees, shift_m):
    found = [judge(seed, 12, 0, degrees=degrees, shift_m=shift_m)[2] for seed in range(RIGS)]
    named = sum(suspects == [[1]] for suspects in found)
    print(f"\n{degrees} deg, {1000 * shift_m:g} mm: camera 1 and no other named in {named} of {len(found)}")
    assert named == len(found)
