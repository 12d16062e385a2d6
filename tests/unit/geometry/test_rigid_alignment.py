"""Rigid alignment against planted motions."""

import numpy as np
import pytest
import scipy.spatial.transform

from pipeline.geometry.rigid_alignment import align_rigid, fit_scale


def motion(seed):
    rng = np.random.default_rng(seed)
    return scipy.spatial.transform.Rotation.random(rng=rng).as_matrix(), rng.normal(0, 2, 3), rng


@pytest.mark.parametrize("seed", range(5))
def test_exact_motion_is_found_exactly(seed):
    R, t, rng = motion(seed)
    points = rng.normal(size=(20, 3))
    alignment = align_rigid(points, points @ R.T + t)
    assert np.abs(alignment.R - R).max() < 1e-12
    assert alignment.t == pytest.approx(t, abs=1e-12)
    assert alignment.apply(points) == pytest.approx(points @ R.T + t)


def test_noise_averages_out():
    R, t, rng = motion(10)
    points = rng.normal(size=(64, 3))
    points *= 2.4 / np.linalg.norm(points, axis=1, keepdims=True)
    alignment = align_rigid(points, points @ R.T + t + rng.normal(0, 0.03, (64, 3)))
    # Centroid 0.03 / 8 = 4 mm per axis; rotation 0.03 / (2.4 sqrt(64 * 2 / 3)) = 1.9 mrad per axis; times 4.
    error = alignment.apply(points) - (points @ R.T + t)
    assert np.linalg.norm(error, axis=1).max() < 4 * np.sqrt(3 * 0.00375**2 + 2 * (2.4 * 0.0019) ** 2)
    assert alignment.sigma == pytest.approx(0.03, rel=0.25)


@pytest.mark.parametrize("seed", range(5))
def test_a_third_of_swapped_points_is_ignored(seed):
    R, t, rng = motion(20 + seed)
    points = rng.normal(size=(30, 3))
    target = points @ R.T + t + rng.normal(0, 1e-3, (30, 3))
    target[:10] = target[[1, 2, 3, 4, 5, 6, 7, 8, 9, 0]]
    alignment = align_rigid(points, target)
    assert np.abs(alignment.R - R).max() < 2e-3
    assert np.abs(alignment.t - t).max() < 2e-3
    assert alignment.weight[:10].max() < 0.01


def test_never_mirrors():
    rng = np.random.default_rng(3)
    points = rng.normal(size=(10, 3))
    alignment = align_rigid(points, points * [1, 1, -1])
    assert np.linalg.det(alignment.R) == pytest.approx(1)


def test_a_plane_of_points_is_enough():
    R, t, rng = motion(4)
    points = rng.normal(size=(6, 3)) * [1, 1, 0]
    assert np.abs(align_rigid(points, points @ R.T + t).R - R).max() < 1e-9


@pytest.mark.parametrize("points", [np.zeros((5, 3)), np.outer(np.arange(5.0), [1, 2, 3]), np.eye(3)[:2]])
def test_points_on_a_line_are_refused(points):
    with pytest.raises(ValueError, match="three pairs"):
        align_rigid(points, points)


@pytest.mark.parametrize("scale", [1e-3, 0.95, 1.0, 100.0])
def test_scale_of_swapped_and_noisy_points(scale):
    R, t, rng = motion(30)
    points = rng.normal(size=(40, 3))
    points *= 2.4 / np.linalg.norm(points, axis=1, keepdims=True)
    target = scale * (points @ R.T + rng.normal(0, 0.03, (40, 3))) + t
    target[:4] = target[[1, 2, 3, 0]]
    found, sigma = fit_scale(points, target)
    # 0.03 / (2.4 sqrt(36)) = 0.2 %; Cauchy's weights make 28 of 36 points, and the swapped ones add to the noise.
    assert sigma / scale == pytest.approx(0.0025, rel=0.25)
    assert abs(found - scale) < 4 * sigma


def test_scale_of_one_point_is_refused():
    with pytest.raises(ValueError, match="three pairs"):
        fit_scale(np.zeros((1, 3)), np.ones((1, 3)))
