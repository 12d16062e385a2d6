"""Error bars by leaving shots out: of independent errors, and of those that the corners of an image share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.calibration.cameras.rig import adjust_rig
from pipeline.calibration.cameras.rig_calibration import Calibrated
from pipeline.calibration.cameras.rig_spread import with_spread
from tests.support.rigs.cameras import (
    BOARD,
    boards_in_stage,
    center_errors,
    observe,
    planted_cameras,
    without_small_views,
)

CAMERAS, VIEWS, RIGS = 4, 20, 8


def adjusted(seed, noise_px=0.1, bend=0.0):
    """A rig and its cameras; images of the board are sheared and stretched at random, by so much of its width."""
    random = np.random.default_rng(seed)
    planted = planted_cameras(CAMERAS, random, arc=1.2)
    cameras = [replace(camera, dist=camera.dist * [1, 1, 0, 0, 0]) for camera in planted]
    boards = boards_in_stage(VIEWS, random, arc=1.2)
    seen, numbers = without_small_views(observe(cameras, boards, noise_px, random))
    pixel = seen.pixel.copy()
    for camera, view in np.unique(np.stack([seen.camera, seen.view], 1), axis=0):
        mine = (seen.camera == camera) & (seen.view == view)
        pixel[mine] += (pixel[mine] - pixel[mine].mean(0)) @ random.normal(0, bend, (2, 2))
    boards = boards[numbers]
    start = [replace(c, R=c.R @ boards[0][:3, :3], t=c.R @ boards[0][:3, 3] + c.t) for c in cameras]
    rig = adjust_rig(replace(seen, pixel=pixel), BOARD.corners_m(), start, np.linalg.inv(boards[0]) @ boards, 2)
    return Calibrated(rig, [2] * CAMERAS, [{}] * CAMERAS, rig), cameras


def errors_over_bars(bend):
    """Root mean squares over rigs: of errors over the least-squares error bars, and over those of the spread."""
    own, spread = [], []
    for seed in range(RIGS):
        calibrated, cameras = adjusted(seed, bend=bend)
        wider = with_spread(calibrated, np.arange(len(calibrated.rig.rig_from_board)))
        errors = center_errors(calibrated.rig.cameras, cameras)
        for found, rig in ((own, calibrated.rig), (spread, wider.rig)):
            focal = [f.K[0, 0] / t.K[0, 0] - 1 for f, t in zip(rig.cameras, cameras, strict=True)]
            found.append([*(focal / rig.focal_sigma), *(errors / rig.center_sigma_m[:, None]).ravel()])
    return [float(np.sqrt(np.mean(np.square(part)))) for part in (own, spread)]


def test_errors_that_an_images_corners_share_are_in_the_error_bars():
    """0.2 % of shear, as of a board that is not flat: a third of a pixel over a board 150 wide."""
    own, spread = errors_over_bars(2e-3)
    assert own > 1.8
    # Of 128 numbers, of which those of a rig go together.
    assert 0.7 < spread < 1.4


def test_independent_errors_leave_error_bars_nearly_as_they_are():
    own, spread = errors_over_bars(0.0)
    assert 0.75 < own < 1.3
    assert 0.85 * own < spread <= own
