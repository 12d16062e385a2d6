"""Residuals of one pass against the same in whole arrays, and nearly exact derivatives against exact ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.geometry.cameras import Camera
from pipeline.geometry.least_squares import CAUCHY, cauchy
from pipeline.geometry.sampling import EDGE_PX, sample_bilinear
from pipeline.tracking.cue_kernels import add_distances, look_up_colors, near_outline
from pipeline.tracking.nearly_projected import project_nearly
from tests.support.figures.walking import ring_of_cameras

FRAMES, POINTS, SEEN = 3, 50, 90
RANDOM = np.random.default_rng(0)
# Multiples of 2^-10, whose differences are exact in float32 as well.
STACK = (RANDOM.integers(-2000, 2000, (FRAMES, 20, 30)) / 1024).astype(np.float32)
IMAGES = (RANDOM.integers(0, 1024, (FRAMES, 20, 30, 3)) / 1024).astype(np.float32)
FRAME, POINT = np.unravel_index(RANDOM.permutation(FRAMES * POINTS)[:SEEN], (FRAMES, POINTS))
PIXELS = RANDOM.uniform(-5, 35, (SEEN, 2))  # some outside
DERIVATIVE, TARGET = RANDOM.normal(size=(SEEN, 2, 3)), RANDOM.normal(size=SEEN)


def test_distances_add_what_whole_arrays_do() -> None:
    value, slope = sample_bilinear(STACK, FRAME, PIXELS)
    residual, row = (value - TARGET) / 0.7, np.einsum("np,npa->na", slope, DERIVATIVE) / 0.7
    losses, weight = cauchy(residual**2)
    expected = np.zeros((FRAMES, POINTS, 3)), np.zeros((FRAMES, POINTS, 3, 3))
    expected[0][FRAME, POINT] = (weight * residual)[:, None] * row
    expected[1][FRAME, POINT] = weight[:, None, None] * row[:, :, None] * row[:, None, :]
    found = np.zeros((FRAMES, POINTS, 3)), np.zeros((FRAMES, POINTS, 3, 3))
    cost = add_distances(STACK, FRAME, POINT, PIXELS, DERIVATIVE, TARGET, 0.7, CAUCHY, EDGE_PX, *found)
    assert np.isclose(cost, losses.sum(), rtol=1e-12)
    for ours, theirs in zip(found, expected, strict=True):
        assert np.allclose(ours, theirs, rtol=1e-12, atol=1e-12)


def test_colors_are_looked_up_as_between_pixels() -> None:
    color, across, down = np.empty((3, SEEN, 3))
    look_up_colors(IMAGES, FRAME, PIXELS, EDGE_PX, color, across, down)
    value, slope = sample_bilinear(IMAGES, FRAME, PIXELS)
    assert np.allclose(color, value, rtol=1e-12, atol=1e-15)
    assert np.allclose(np.stack([across, down], -1), slope, rtol=1e-12, atol=1e-15)


def test_a_pixel_that_is_no_number_reads_nothing_outside() -> None:
    color, across, down = np.empty((3, 2, 3))
    look_up_colors(
        IMAGES, np.zeros(2, np.int64), np.array([[np.nan, np.inf], [-np.inf, 1e300]]), EDGE_PX, color, across, down
    )
    assert np.isfinite(color).all()


def test_points_near_an_outline_are_those_of_small_distance() -> None:
    pixels, depth, chosen = RANDOM.uniform(-5, 45, (200, 2)), RANDOM.uniform(-0.2, 1, 200), np.arange(0, 200, 2)
    number, target = np.empty(len(chosen), np.int64), np.empty(len(chosen))
    count = near_outline(STACK[0], (4, 7), pixels, depth, chosen, 40, 38, 0.5, EDGE_PX, number, target)
    inside = (depth > 0) & (pixels > 0).all(1) & (pixels < [38, 40]).all(1)
    value, _ = sample_bilinear(STACK[:1], np.zeros(200, np.int64), pixels - [7, 4])
    expected = np.flatnonzero((inside & (np.abs(value) < 0.5))[chosen])
    assert 0 < count < len(chosen)
    assert (number[:count] == expected).all()
    assert np.allclose(target[:count], value[chosen][expected], rtol=1e-12)


def test_without_distortion_nearly_exact_derivatives_are_exact() -> None:
    points = RANDOM.uniform([-0.5, 0.5, -0.5], [0.5, 1.5, 0.5], (40, 3))
    for camera in ring_of_cameras(3).values():
        plain: Camera = replace(camera, dist=np.zeros(5))
        pixels, derivative = project_nearly(plain, points)
        exact = plain.project_with_derivative(points)
        assert np.allclose(pixels, exact[0], rtol=1e-12)
        assert np.allclose(derivative, exact[1], rtol=1e-10, atol=1e-9)
