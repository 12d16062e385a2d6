"""Gaze from pictures of painted spheres, whose gaze is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.base.conventions import PIXEL_CENTER
from pipeline.eyes.eye_pixels import LEAST_PIXELS, MARGIN_PX, join_views, meet_sphere, seen_pixels
from pipeline.eyes.eye_verdicts import estimate_verdict
from pipeline.eyes.gaze_estimate import FINE, LEAST_EXPLAINED, estimate_gaze, grid_around
from tests.support.avatars.painted_eyes import CENTER, LOOKS, RADIUS_M, SHAPE, cameras, painted

FINEST_DEG = FINE[-1][1]
PARALLAX_DEG = 1.0
"""A pixel of 1.2 mm is 5.7 degrees of an eyeball. Its edges with an iris of 25 degrees cross some 25 pixels of each of
five pictures, and where an edge lies in a pixel of one colour is uncertain by 0.3 of it: 5.7 x 0.3 / sqrt(125) = 0.15
degrees; 1 leaves room for the parallax of the bulging cornea, of which the painted pictures have one and the
profile's bins of 3 degrees a coarse one."""


def pixels_of(gaze, lids=np.inf, most=5, **painting):
    head = Rotation.from_euler("YXZ", [20, -5, 8], degrees=True).as_matrix(), np.array([0.02, 0.1, -0.03])
    inverse = np.column_stack([head[0].T, -head[0].T @ head[1]])
    found = []
    for camera in list(cameras(head))[:most]:
        depth = np.full((camera.height, camera.width), lids, np.float32)
        found.append(seen_pixels(camera, painted(camera, head, gaze, **painting), depth, inverse, CENTER, RADIUS_M))
    return join_views(found)


@pytest.fixture(scope="module")
def shown():
    return [pixels_of(gaze) for gaze in LOOKS]


def test_gaze_of_painted_eyes_is_found_past_glints(shown):
    for gaze, found in zip(LOOKS, estimate_gaze(shown, SHAPE), strict=True):
        assert found.status == "estimated" and found.views == 5
        assert np.degrees(np.arccos(min(1.0, float(found.direction @ gaze)))) < PARALLAX_DEG
        assert FINEST_DEG / 2 <= found.sigma_deg < PARALLAX_DEG
        assert np.linalg.norm(found.direction) == pytest.approx(1, abs=1e-12)


def test_closed_lids_of_the_template_leave_the_gaze_undefined(shown):
    closed = pixels_of(LOOKS[0], lids=0.4)
    assert len(closed) == 0
    found = estimate_gaze([shown[0], closed, shown[1]], SHAPE)
    assert [each.status for each in found] == ["estimated", "hidden", "estimated"]
    assert np.isnan(found[1].direction).all() and np.isnan(found[1].sigma_deg)
    verdict = estimate_verdict("left", [4, 7, 9], found)
    assert verdict.grade == "weak" and "undefined in 1 frames, as lids hide the eye: 7" in verdict.reason
    only = estimate_verdict("left", [7], estimate_gaze([closed], SHAPE))
    assert only.grade == "failed" and "not estimated" in only.reason


def test_lids_that_the_template_lacks_show_no_iris(shown):
    found = estimate_gaze([*shown, pixels_of(LOOKS[0], skin=True)], SHAPE)
    assert [each.status for each in found] == ["estimated"] * 3 + ["unclear"]
    assert "no iris shows: 3" in estimate_verdict("left", [0, 1, 2, 3], found).reason


def test_skin_that_darkens_towards_an_edge_shows_no_iris(shown):
    """Three fifths as bright at one side as opposite: the profile learns the slope, and explains all of it."""
    shaded = [pixels_of(gaze) for gaze in LOOKS]
    for pixels in shaded:
        hits = pixels.origins + meet_sphere(pixels.origins, pixels.directions, RADIUS_M)[0][:, None] * pixels.directions
        away = np.degrees(np.arccos(np.clip(hits @ [0.8, 0.0, 0.6] / RADIUS_M, -1, 1)))
        pixels.colors[:] = np.interp(away, [0, 60], [0.6, 1.0])[:, None] * [0.6, 0.4, 0.3]
    found = estimate_gaze(shaded, SHAPE)
    assert [each.status for each in found] == ["unclear"] * len(LOOKS)
    assert min(each.explained for each in found) > LEAST_EXPLAINED, "darkness alone tells it from an eye"


def test_one_picture_is_too_few(shown):
    assert [each.status for each in estimate_gaze([shown[0], pixels_of(LOOKS[1], most=1)], SHAPE)][1] == "hidden"


def test_black_pictures_show_nothing_and_break_nothing(shown):
    black = pixels_of(LOOKS[0])
    black.colors[:] = 0
    assert estimate_gaze([shown[0], black], SHAPE)[1].status == "unclear"
    assert estimate_gaze([], SHAPE) == []


def test_pixels_beside_skin_and_those_that_are_no_number_are_left_out():
    head = np.eye(3), np.zeros(3)
    camera = next(iter(cameras(head)))
    inverse = np.column_stack(head)
    image = painted(camera, head, LOOKS[0])
    free = np.full(image.shape[:2], np.inf, np.float32)
    lid = free.copy()
    lid[:30] = 0.3
    all_of_it, below = (seen_pixels(camera, image, depth, inverse, CENTER, RADIUS_M) for depth in (free, lid))
    rows = camera.project(
        CENTER + below.origins + meet_sphere(below.origins, below.directions, RADIUS_M)[0][:, None] * below.directions
    )[0][:, 1]
    assert LEAST_PIXELS < len(below) < len(all_of_it)
    assert rows.min() == pytest.approx(30 + MARGIN_PX + PIXEL_CENTER, abs=1e-6)
    image[:] = np.nan
    assert len(seen_pixels(camera, image, free, inverse, CENTER, RADIUS_M)) == 0


def test_eye_beside_or_behind_the_camera_has_no_pixel():
    head = np.eye(3), np.zeros(3)
    camera = next(iter(cameras(head)))
    image, free = painted(camera, head, LOOKS[0]), np.full((60, 64), np.inf, np.float32)
    for place in (camera.center + 0.3 * camera.R[2] + 0.5 * camera.R[0], camera.center - 0.3 * camera.R[2]):
        assert len(seen_pixels(camera, image, free, np.column_stack(head), place, RADIUS_M)) == 0


def test_grid_has_equal_steps_and_its_middle_first():
    grid = grid_around(np.array([0.0, 3.0, 4.0]), 10.0, 2.5)
    np.testing.assert_allclose(grid[0], [0, 0.6, 0.8], atol=1e-15)
    angles = np.degrees(np.arccos(np.clip(grid @ grid[0], -1, 1)))
    assert angles.max() == pytest.approx(10.0) and np.sort(angles)[1] == pytest.approx(2.5)
    np.testing.assert_allclose(np.linalg.norm(grid, axis=1), 1, atol=1e-12)
