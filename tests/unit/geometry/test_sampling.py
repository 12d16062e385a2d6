"""Looking up images whose values are known between pixels: planes, of which bilinear values and slopes are exact."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.geometry.sampling import sample_bilinear

SLOPES = np.array([[0.25, -0.5], [2.0, 1.0], [0.0, 0.125]])
"""Of three channels, by x and y; small powers of two, so that float32 is exact."""


def planes(frames: int = 2) -> np.ndarray:
    """Images [frames, 12, 16, 3] whose value at the pixel (x, y), counted from the corner, is the frame + slopes."""
    rows, columns = np.mgrid[0:12, 0:16] + 0.5
    values = np.stack([x * columns + y * rows for x, y in SLOPES], -1)
    return np.stack([values + frame for frame in range(frames)]).astype(np.float32)


def test_planes_are_looked_up_exactly_between_pixels() -> None:
    rng = np.random.default_rng(0)
    pixels = rng.uniform([0.5, 0.5], [15.49, 11.49], (200, 2))
    frame = rng.integers(0, 2, 200)
    value, gradient = sample_bilinear(planes(), frame, pixels)
    np.testing.assert_allclose(value, pixels @ SLOPES.T + frame[:, None], atol=1e-12)
    np.testing.assert_allclose(gradient, np.tile(SLOPES, (200, 1, 1)), atol=1e-12)


@pytest.mark.parametrize(("outside", "edge"), [((-3.0, 5.0), (0.5, 5.0)), ((8.0, 40.0), (8.0, 11.5))])
def test_beside_the_image_there_is_its_nearest_edge(outside, edge) -> None:
    pixels = np.array([outside, edge])
    value, _ = sample_bilinear(planes(), np.zeros(2, np.int64), pixels)
    np.testing.assert_allclose(value[0], value[1], atol=1e-12)
    np.testing.assert_allclose(value[1], np.array(edge) @ SLOPES.T, atol=2e-3)  # EDGE_PX of the steepest slope
