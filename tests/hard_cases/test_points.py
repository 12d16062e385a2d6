"""Rigid motions and rays with too little to go by: flat, mirrored, three points only, two cameras, nearly parallel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.geometry.cameras import Camera
from pipeline.geometry.rigid_alignment import align_rigid, fit_scale
from pipeline.geometry.triangulation import reprojection, triangulate
from tests.support.figures.walking import ring_of_cameras
from tests.support.results.hard_case import HardCase, worst

TURN, STEP = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix(), np.array([1.0, -2.0, 0.5])

BOX = np.array([[x, y, z] for x in (-1, 1) for y in (-0.7, 0.7) for z in (-1e-3, 1e-3)])
"""Corners of a board, 2 mm thick."""


def kabsch_without_determinant(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    U, _, Vt = np.linalg.svd((target - target.mean(0)).T @ (source - source.mean(0)))
    return U @ Vt


@pytest.mark.parametrize("thickness", [0.0, 1.0])
def test_a_board_whose_noise_mirrors_it(case: HardCase, thickness: float) -> None:
    """Front and back exchanged, by noise of 2 mm or because it is flat: the turn is that of the board, no mirror."""
    source = BOX * [1, 1, thickness]
    target = source * [1, 1, -1] @ TURN.T + STEP
    found = align_rigid(source, target)
    case.check(worst(found.R, TURN), 1e-9)
    if thickness:
        case.naive_fails(worst(kabsch_without_determinant(source, target), TURN))


def test_three_points(case: HardCase) -> None:
    source = np.array([[0.0, 0, 0], [1, 0, 0], [0, 0.5, 0]])
    found = align_rigid(source, source @ TURN.T + STEP)
    case.check(worst(found.R, TURN) + worst(found.t, STEP), 1e-12)


@pytest.mark.parametrize("lost", [1, 3])
def test_wrong_pairs_among_the_points(case: HardCase, lost: int) -> None:
    """Up to three of ten light positions swapped or lost by metres; least squares goes with them."""
    source = np.random.default_rng(0).normal(size=(10, 3))
    target = source @ TURN.T + STEP
    target[:lost] += [5.0, -3, 4]
    found = align_rigid(source, target)
    case.check(worst(found.R, TURN), 1e-6)
    case.naive_fails(worst(kabsch_without_determinant(source, target), TURN))


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_scale_of_a_flat_board(case: HardCase, scale: float) -> None:
    source = BOX * [1, 1, 0]
    found, _ = fit_scale(source, scale * (source @ TURN.T) + STEP)
    case.check(worst(found, scale), 1e-9)


@pytest.mark.parametrize("points", [np.zeros((5, 3)), np.outer(np.arange(5.0), [1, 2, 3])], ids=["a point", "a line"])
def test_points_on_a_line_are_refused(case: HardCase, points: np.ndarray) -> None:
    """No turn about the line is better than another: said, not guessed."""
    with pytest.raises(ValueError, match="three pairs"):
        align_rigid(points, points @ TURN.T)


def test_three_keypoints_seen_by_two_cameras(case: HardCase) -> None:
    cameras = list(ring_of_cameras(6).values())[:2]
    points = np.array([[0.1, 0.3, 0.0], [-0.3, 1.0, 0.2], [0.0, 1.7, -0.1]])
    seen = np.stack([camera.undistort(camera.project(points)[0]) for camera in cameras])
    found = triangulate(cameras, seen, np.ones((2, 3)), 4.0)
    assert np.isfinite(found.sigma_m).all()
    # Undistortion iterates to 1e-12 of 3.5 m.
    case.check(np.abs(found.points - points).max(), 1e-8, unit="m")


def seen_side_by_side(apart_m: float) -> tuple[list[Camera], np.ndarray, np.ndarray]:
    """Two cameras, 2,000 points 3.5 m away, and where they are seen, with noise of 0.3 px."""
    one = next(iter(ring_of_cameras(6).values()))
    cameras = [one, replace(one, t=one.t + np.array([apart_m, 0, 0]))]
    points = np.random.default_rng(2).uniform([-0.5, 0.2, -0.5], [0.5, 1.7, 0.5], (2000, 3))
    noise = np.random.default_rng(3)
    seen = np.stack([c.undistort(c.project(points)[0] + 0.3 * noise.normal(size=(2000, 2))) for c in cameras])
    return cameras, points, seen


def test_two_cameras_side_by_side_know_how_little_they_know(case: HardCase) -> None:
    """A decimetre apart, 3.5 m away: stated standard deviations against true errors, half of which should exceed 0.6745
    of them. The median of n = 2,000 such errors has a standard deviation of 1 / (2 p sqrt(n)), p = 0.6356 being the
    density of |N(0, 1)| there: 2.6 %. So has the noise, which comes from as many other numbers. Three times both."""
    cameras, points, seen = seen_side_by_side(0.1)
    found = triangulate(cameras, seen, np.ones((2, 2000)), 4.0)
    # Nearly all of the error is along the rays: sigma_m is the root mean square over three axes.
    error = np.linalg.norm(found.points - points, axis=1) / np.sqrt(3)
    case.check(abs(np.median(error / found.sigma_m) / 0.6745 - 1), 3 * np.hypot(0.026, 0.026))
    # The median of single residuals: those along the base line are fitted exactly, and are half of all.
    _, residual, _ = reprojection(cameras, seen, found.points)
    naive = found.sigma_m * np.median(np.abs(residual)) / 0.6745 * 2 / found.noise_px  # 2: one number left of four
    case.naive_fails(abs(np.median(error / naive) / 0.6745 - 1))


def test_two_cameras_a_millimetre_apart_place_nothing(case: HardCase) -> None:
    """The disparity is a third of a pixel, its noise 0.42 px: only what lies five times that from infinity may be
    placed, by chance at most 2.3 points in 10^5 (the nearest, at 2.9 m). Of 2,000, three or more have a probability
    of 2 in 10^5. Naive: all rays that meet in front at more than 0.06 degrees; they meet far too near, and say that
    they know it."""
    cameras, _, seen = seen_side_by_side(1e-3)
    found = triangulate(cameras, seen, np.ones((2, 2000)), 4.0)
    case.check(np.isfinite(found.points).all(1).mean(), 2 / 2000)
    case.naive_fails((seen[1, :, 0] - seen[0, :, 0] > 1e-3).mean())


def test_two_cameras_a_centimetre_apart_say_which_points_they_know(case: HardCase) -> None:
    """Disparity is eight times its noise in the middle: points are placed, and two of three within one stated standard
    deviation, 68.3 % with one of 1.04 % over 2,000. Distance is the inverse of what has normal errors, so that far ones
    are farther off than near ones: to first order that cancels, to second, (1 / 8)^2, it does not. Three times the
    first and twice the second."""
    cameras, points, seen = seen_side_by_side(1e-2)
    found = triangulate(cameras, seen, np.ones((2, 2000)), 4.0)
    known = np.isfinite(found.points).all(1)
    assert known.mean() > 0.95
    error = np.linalg.norm(found.points - points, axis=1)[known] / np.sqrt(3)
    case.check(abs((error < found.sigma_m[known]).mean() - 0.6827), 3 * 0.0104 + 2 / 64)
