"""Interpolated outlines against discs that move and grow, and which frames get one."""

from __future__ import annotations

import numpy as np

from pipeline.geometry.cameras import Camera
from pipeline.geometry.signed_distance import View, view_from_masks
from pipeline.tracking.mask_interpolation import interpolated_views

ROWS, COLUMNS = np.indices((80, 100)) + 0.5


def disc(x: float, y: float, radius: float) -> np.ndarray:
    """Distance to the outline, positive inside."""
    return radius - np.hypot(COLUMNS - x, ROWS - y)


def view_of(discs: list[tuple[float, float, float] | None]) -> View:
    camera = Camera(np.eye(3), np.zeros(3), np.array([[90.0, 0, 50], [0, 90, 40], [0, 0, 1]]), np.zeros(5), 100, 80)
    masks = [None if one is None else np.where(disc(*one) > 0, 255, 0).astype(np.uint8) for one in discs]
    return view_from_masks(camera, masks)


def test_a_disc_that_moves_and_grows_is_found_between_its_masks() -> None:
    # Further than its own radius, and seen at unequal times.
    view = view_of([(30.0, 35.0, 10.0), None, None, (54.0, 41.0, 16.0)])
    times = np.array([0.0, 0.1, 0.25, 0.4])
    (between,) = interpolated_views([view], times, np.zeros(4, np.int64), 2)
    assert between.usable.tolist() == [False, True, True, False]
    for frame, share in ((1, 0.25), (2, 0.625)):
        truth = disc(30 + 24 * share, 35 + 6 * share, 10 + 6 * share)
        near = np.abs(truth) < 3
        error = (between.distance[frame] - truth)[near]
        # Binary masks place their outlines to half a pixel.
        assert np.abs(error).max() < 0.7 and abs(error.mean()) < 0.15


def test_only_frames_near_masks_of_their_take_get_one() -> None:
    there, times = (40.0, 40.0, 12.0), np.arange(8.0)
    view = view_of([None, there, None, there, None, None, None, there])
    (between,) = interpolated_views([view], times, np.zeros(8, np.int64), 2)
    assert np.flatnonzero(between.usable).tolist() == [2, 5]
    (between,) = interpolated_views([view], times, np.array([0, 0, 0, 1, 1, 1, 1, 1]), 3)
    assert np.flatnonzero(between.usable).tolist() == [4, 5, 6]
