"""Reduced images against block sums by hand, and against the camera that is to have made them."""

from __future__ import annotations

import numpy as np

from pipeline.capture.reduced_images import block_means, reduction
from pipeline.geometry.cameras import Camera


def a_camera(width: int, height: int) -> Camera:
    return Camera(np.eye(3), np.zeros(3), np.array([[90.0, 0, 41], [0, 90, 33], [0, 0, 1]]), np.zeros(5), width, height)


def test_the_least_whole_factor_is_taken() -> None:
    factors = [reduction(a_camera(width, 100), 256) for width in (200, 256, 257, 512, 513)]
    assert factors == [1, 1, 2, 2, 3]


def test_blocks_are_averaged_and_sizes_are_the_cameras() -> None:
    image = np.random.default_rng(0).uniform(size=(67, 83, 3))
    for factor in (1, 2, 3, 4):
        small = a_camera(83, 67).downsampled(float(factor))
        means = block_means(image, factor, small)
        assert means.shape == (small.height, small.width, 3) and means.dtype == np.float32
        np.testing.assert_allclose(means[2, 5], image[2 * factor :, 5 * factor :][:factor, :factor].mean((0, 1)), 1e-6)


def test_what_the_camera_sees_stays_where_it_sees_it() -> None:
    camera, point = a_camera(84, 68), np.array([0.1, -0.07, 1.0])
    rows, columns = np.indices((68, 84)) + 0.5
    x, y = camera.project(point)[0]
    blob = np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * 6.0**2))
    for factor in (2, 4):
        small = camera.downsampled(float(factor))
        means = block_means(blob, factor, small)
        rows_, columns_ = np.indices(means.shape) + 0.5
        found = np.array([(means * columns_).sum(), (means * rows_).sum()]) / means.sum()
        np.testing.assert_allclose(found, small.project(point)[0], atol=0.02)
