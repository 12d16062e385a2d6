"""Cameras of a ring joined by single views, whose mirrored poses only the whole ring tells apart."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.calibration.cameras.rig_calibration import calibrate_rig
from pipeline.calibration.cameras.rig_join import Sighting, place_board
from pipeline.calibration.cameras.rig_start import possible_starts, start_rig
from tests.support.rigs.cameras import (
    BOARD,
    SIZE,
    boards_in_stage,
    center_errors,
    observe,
    planted_cameras,
    without_small_views,
)

CAMERAS = 8


def ring(seed):
    """Eight cameras around the stage; each pair of neighbours shares one view, and each camera has two of its own."""
    rng = np.random.default_rng(seed)
    cameras = planted_cameras(CAMERAS, rng, arc=2 * np.pi)
    seen = observe(cameras, boards_in_stage(150, rng, arc=2.4 * np.pi), 0.1, rng)
    wanted = {(c,): 2 for c in range(CAMERAS)} | {tuple(sorted((c, (c + 1) % CAMERAS))): 1 for c in range(CAMERAS)}
    keep = np.zeros(len(seen.camera), bool)
    for view in np.unique(seen.view):
        whole = [c for c in range(CAMERAS) if np.sum((seen.view == view) & (seen.camera == c)) == 24]
        for group, left in wanted.items():
            if left and set(group) <= set(whole):
                wanted[group] -= 1
                keep |= (seen.view == view) & np.isin(seen.camera, group)
                break
    assert not any(wanted.values())
    return cameras, without_small_views(seen.select(keep))[0]


def farthest(found, true):
    return np.linalg.norm(center_errors(found, true), axis=1).max()


@pytest.mark.parametrize("seed", range(4))
def test_a_ring_joined_by_single_views(seed):
    cameras, observations = ring(seed)
    start = start_rig(observations, BOARD.corners_m(), [SIZE] * CAMERAS)
    # Four views know a focal length to a few per cent of 2.5 m; a mirrored pose puts cameras metres away.
    assert farthest(start.cameras, cameras) < 0.6
    rig = calibrate_rig(observations, BOARD.corners_m(), [SIZE] * CAMERAS, "auto").rig
    assert farthest(rig.cameras, cameras) < 0.1
    assert np.median(np.linalg.norm(rig.residual, axis=1)) < 0.2


def test_what_no_loop_decides_stays_open():
    """Without the last camera the ring is a chain, in which mirrored poses fit almost as well: all are kept."""
    cameras, observations = ring(0)
    open_ring = without_small_views(observations.select(observations.camera != CAMERAS - 1))[0]
    starts = possible_starts(open_ring, BOARD.corners_m(), [SIZE] * (CAMERAS - 1))
    assert len(starts) > 1
    assert min(farthest(start.cameras, cameras[:-1]) for start in starts) < 0.6


def test_board_stands_in_front_of_its_camera_though_one_behind_fits_as_well():
    """A flat board whose points are all negated is another one, turned by half a turn, behind: with the same pixels."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([0.4, -0.3, 0.2]).as_matrix()
    pose[:3, 3] = 0.1, -0.2, 2.0
    behind = pose * np.array([-1.0, -1.0, 1.0, -1.0])
    behind[3, 3] = 1.0
    points = BOARD.corners_m()
    in_camera, in_back = (points @ each[:3, :3].T + each[:3, 3] for each in (pose, behind))
    np.testing.assert_allclose(in_back, -in_camera, atol=1e-15)
    for candidates in ([pose, behind], [behind, pose]):
        seen = Sighting(points, np.eye(3), in_camera[:, :2] / in_camera[:, 2:], 700.0, np.stack(candidates))
        found, cost = place_board({0: {0: seen}}, {0: np.eye(4)}, 0)
        np.testing.assert_allclose(found, pose, atol=1e-12)
        assert cost < 1e-9
