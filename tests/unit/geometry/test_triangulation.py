"""Triangulation of planted points: exact without noise, robust to wrong cameras, and honest about its uncertainty."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.geometry.triangulation import MAX_PAIRS, camera_pairs, reprojection, triangulate
from tests.support.figures.walking import ring_of_cameras

INLIER_PX = 4.0


def observe(cameras: list, points: np.ndarray, noise_px: float, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    seen = []
    for camera in cameras:
        pixels, _ = camera.project(points)
        seen.append(camera.undistort(pixels + noise_px * rng.normal(size=pixels.shape)))
    return np.stack(seen)


@pytest.fixture
def cameras() -> list:
    return list(ring_of_cameras(6).values())


@pytest.fixture
def points() -> np.ndarray:
    return np.random.default_rng(2).uniform([-0.5, 0.2, -0.5], [0.5, 1.7, 0.5], (400, 3))


def test_exact_observations_give_exact_points(cameras: list, points: np.ndarray) -> None:
    found = triangulate(cameras, observe(cameras, points, 0.0), np.ones((6, 400)), INLIER_PX)
    assert np.abs(found.points - points).max() < 1e-8  # undistortion iterates to 1e-12 of 3.5 m
    assert found.inlier.all()
    assert found.noise_px < 1e-5


def test_noise_and_standard_deviation_are_estimated(cameras: list, points: np.ndarray) -> None:
    found = triangulate(cameras, observe(cameras, points, 0.7), np.ones((6, 400)), INLIER_PX)
    assert found.noise_px == pytest.approx(0.7, rel=0.05)
    whitened = (found.points - points) / found.sigma_m[:, None]
    assert np.sqrt((whitened**2).mean()) == pytest.approx(1.0, rel=0.1)


def test_wrong_observations_are_flagged_and_do_no_harm(cameras: list, points: np.ndarray) -> None:
    observed = observe(cameras, points, 0.3)
    rng = np.random.default_rng(9)
    wrong = np.zeros((6, 400), bool)
    for point in range(400):
        wrong[rng.choice(6, 2, replace=False), point] = True
    observed[wrong] += rng.choice([-1, 1], (wrong.sum(), 2)) * rng.uniform(0.02, 0.2, (wrong.sum(), 2))
    found = triangulate(cameras, observed, np.ones((6, 400)), INLIER_PX)
    error = np.linalg.norm(found.points - points, axis=1)
    # Two wrong rays of six can meet by chance and win against four with noise; that must stay rare.
    assert np.mean(error < 0.01) > 0.99
    assert np.mean(found.inlier[wrong]) < 0.01
    assert np.mean(found.inlier[~wrong]) > 0.99


def test_confidence_weighs_observations(cameras: list, points: np.ndarray) -> None:
    observed = observe(cameras, points, 0.1)
    observed[0] += 1.5 / cameras[0].K[0, 0]
    trusting, wary = np.ones((6, 400)), np.ones((6, 400))
    wary[0] = 0.01
    errors = [np.linalg.norm(triangulate(cameras, observed, c, INLIER_PX).points - points, axis=1).mean()
              for c in (trusting, wary)]  # fmt: skip
    assert errors[1] < 0.3 * errors[0]


def test_missing_observations_give_nan_only_where_fewer_than_two_remain(cameras: list, points: np.ndarray) -> None:
    observed, confidence = observe(cameras, points, 0.0), np.ones((6, 400))
    observed[1:, 0] = np.nan
    observed[:, 1] = np.nan
    confidence[2:, 2] = 0.0
    found = triangulate(cameras, observed, confidence, INLIER_PX)
    assert np.isnan(found.points[:2]).all()
    assert np.isnan(found.sigma_m[:2]).all()
    assert np.isfinite(found.points[2:]).all()
    assert np.abs(found.points[2:] - points[2:]).max() < 1e-7
    assert found.inlier[:, 2].tolist() == [True, True, False, False, False, False]


def test_parallel_rays_and_cameras_in_one_place_give_no_point(cameras: list, points: np.ndarray) -> None:
    twins = [cameras[0], cameras[0]]
    found = triangulate(twins, observe(twins, points, 0.0), np.ones((2, 400)), INLIER_PX)
    assert np.isnan(found.points).all()
    assert not found.inlier.any()
    assert found.noise_px == 0.0


def test_derivative_is_that_of_the_residual(cameras: list, points: np.ndarray) -> None:
    observed, step = observe(cameras, points[:20], 1.0), 1e-6
    _, _, jacobian = reprojection(cameras, observed, points[:20])
    for axis in range(3):
        shift = step * np.eye(3)[axis]
        ahead, behind = (reprojection(cameras, observed, points[:20] + s)[1] for s in (shift, -shift))
        assert np.allclose(jacobian[..., axis], (ahead - behind) / (2 * step), rtol=1e-6, atol=1e-4)


def test_a_point_behind_a_camera_is_infinitely_far_from_it(cameras: list) -> None:
    behind = (cameras[0].center - cameras[0].R[2])[None]
    length, _, _ = reprojection(cameras[:1], np.zeros((1, 1, 2)), behind)
    assert np.isinf(length).all()


def test_many_cameras_are_sampled_in_pairs() -> None:
    assert len(camera_pairs(12)) == 66
    pairs = camera_pairs(300)
    assert len(set(pairs)) == MAX_PAIRS
    assert pairs == camera_pairs(300)
    assert all(a < b for a, b in pairs)
