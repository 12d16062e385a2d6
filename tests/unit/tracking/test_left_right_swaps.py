"""Exchanged keypoints: planted ones are found, and only these."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.geometry.triangulation import triangulate
from pipeline.tracking.left_right_swaps import exchanged, find_left_right_swaps
from tests.support.figures.walking import ring_of_cameras, walk

INLIER_PX = 12.0
"""At sensor resolution, where the noise below is 1.4 px."""


@pytest.fixture
def cameras() -> list:
    return list(ring_of_cameras(6).values())


def observe(cameras: list, points: np.ndarray) -> np.ndarray:
    random = np.random.default_rng(1)
    seen = []
    for camera in cameras:
        pixels, _ = camera.project(points.reshape(-1, 3))
        seen.append(camera.undistort(pixels + 1.4 * random.normal(size=pixels.shape)).reshape(*points.shape[:2], 2))
    return np.stack(seen)


def test_planted_swaps_are_found_and_only_these(cameras: list) -> None:
    points = walk(8).joints
    clean = observe(cameras, points)
    planted = np.array([(2, 0, 3, 5), (2, 0, 4, 6), (2, 3, 7, 9), (4, 5, 4, 6)])
    observed = exchanged(clean, planted)
    found = triangulate(cameras, observed.reshape(6, -1, 2), np.ones((6, 88)), INLIER_PX)
    swaps = find_left_right_swaps(cameras, observed, found.points.reshape(points.shape), INLIER_PX)
    assert swaps.tolist() == planted.tolist()
    assert np.array_equal(exchanged(observed, swaps), clean)


def test_missing_and_wild_observations_are_no_swaps(cameras: list) -> None:
    points = walk(4).joints
    observed = observe(cameras, points)
    observed[1, 2, 3] = np.nan
    observed[3, :, 5] += 0.2
    missing = points.copy()
    missing[1, 7] = np.nan
    assert find_left_right_swaps(cameras, observed, missing, INLIER_PX).shape == (0, 4)


def seen_by(camera, points: np.ndarray) -> np.ndarray:
    """Observations [1, 1, points, 2] of one camera in one frame, without noise."""
    return camera.undistort(camera.project(points)[0])[None, None]


def test_keypoints_that_lie_on_each_other_and_fit_are_left_alone(cameras: list) -> None:
    """A wrist in front of an elbow: either observation would do for both, and nothing says that they changed places.

    Not even that each fits the other's point better, as long as each fits its own.
    """
    points = walk(1).joints[0].copy()
    points[4] = points[3] + [0.0, 0.01, 0.0]
    other_way = points.copy()
    other_way[[3, 4]] = points[[4, 3]]
    for shown in (points, other_way):
        seen = seen_by(cameras[0], shown)
        assert find_left_right_swaps(cameras[:1], seen, points[None], INLIER_PX).shape == (0, 4)


def test_keypoint_changes_places_with_the_one_that_fits_it_best(cameras: list) -> None:
    """3 and 7 are exchanged; 4, a centimetre beside 3, was mistaken for 7 as well, and stays wrong."""
    points = walk(1).joints[0].copy()
    points[4] = points[3] + [0.0, 0.01, 0.0]
    shown = points.copy()
    shown[3], shown[7], shown[4] = points[7], points[3], points[7] + [0.0, 0.005, 0.0]
    found = find_left_right_swaps(cameras[:1], seen_by(cameras[0], shown), points[None], INLIER_PX)
    assert found.tolist() == [[0, 0, 3, 7]]
