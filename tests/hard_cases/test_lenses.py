"""Lenses where their formulas are 0 / 0, reach 90 degrees and pass it, or fold over; against mpmath and differences."""

from __future__ import annotations

import cv2
import mpmath
import numpy as np
import pytest

from pipeline.capture.undistortion import (
    Box,
    distorted_positions,
    left_out,
    seen_pixels,
    undistort_image,
    undistort_mask,
)
from pipeline.geometry.cameras import Camera, project_with_jacobian
from pipeline.geometry.lenses import BROWN_CONRADY, FISHEYE
from tests.support.naive.surfaces import opencv_rays
from tests.support.results.hard_case import worst

TERMS = np.array([-0.03, 0.012, -0.005, 0.0007])
"""theta_d grows up to 180 degrees."""

FOLDING = np.array([-0.3, 0.0, 0.0, 0.0])
"""theta_d = theta - 0.3 theta^3 grows up to sqrt(1 / 0.9) = 60.4 degrees."""

ANGLES = {
    "on the axis": 0.0,
    "1e-200 beside the axis": 1e-200,
    "1e-9 beside the axis": 1e-9,
    "45 degrees": np.pi / 4,
    "1e-9 before 90 degrees": np.pi / 2 - 1e-9,
    "90 degrees": None,
    "1e-9 beyond 90 degrees": np.pi / 2 + 1e-9,
    "120 degrees": 2 * np.pi / 3,
    "1e-6 before straight behind": np.pi - 1e-6,
}


def point_at(angle, around=0.7, distance=2.0):
    """A point at an angle from the optical axis; None: 90 degrees exactly."""
    if angle is None:
        return np.array([[distance * np.cos(around), distance * np.sin(around), 0.0]])
    radius = distance * np.sin(angle)
    return np.array([[radius * np.cos(around), radius * np.sin(around), distance * np.cos(angle)]])


def exact_fisheye(x, y, z, *terms):
    """By mpmath, from the definition."""
    r = mpmath.hypot(x, y)
    if r == 0:
        return mpmath.mpf(0), mpmath.mpf(0)
    theta = mpmath.atan2(r, z)
    theta_d = theta * (1 + sum(k * theta ** (2 * n) for n, k in enumerate(terms, 1)))
    return theta_d * x / r, theta_d * y / r


def exact_jacobian(point, terms):
    """Derivatives [2, 3 + terms] by mpmath's differences of 60 digits."""
    numbers = [mpmath.mpf(float(value)) for value in (*point, *terms)]
    with mpmath.workdps(60):
        return np.array([
            [float(mpmath.diff(lambda v, k=k, row=row: exact_fisheye(*numbers[:k], v, *numbers[k + 1 :])[row],
                               numbers[k], h=mpmath.mpf(10) ** -25))
             for k in range(len(numbers))]
            for row in range(2)
        ])  # fmt: skip


@pytest.mark.parametrize("where", ANGLES)
def test_fisheye_and_its_jacobian(case, where):
    point = point_at(ANGLES[where])
    with mpmath.workdps(60):
        expected = np.array([[float(value) for value in exact_fisheye(*map(mpmath.mpf, point[0]), *TERMS)]])
    distorted, by_point, by_terms = FISHEYE.jacobian(point, TERMS[None], np.ones((1, 2)))
    np.testing.assert_array_equal(distorted, FISHEYE.distort(point, TERMS))
    slopes = exact_jacobian(point[0], TERMS)
    found = np.concatenate([by_point[0], by_terms[0]], 1)
    # Straight behind, the derivative across the axis grows as 1 / r, and the rounding of r with it: 1e-16 / 1e-6.
    bound = 1e-9 if "behind" in where else 1e-13
    case.check(worst(distorted, expected), 1e-14, worst(found, slopes), bound)
    if where in ("on the axis", "1e-200 beside the axis"):
        x, y, z = point[0]
        with np.errstate(invalid="ignore"):
            case.naive_fails(worst(np.arctan2(np.sqrt(x * x + y * y), z) * point[0, :2] / np.sqrt(x * x + y * y), 0.0))
    if where == "90 degrees":
        # By x / z and y / z, as OpenCV documents it.
        with np.errstate(divide="ignore", invalid="ignore"):
            a = point[0, :2] / point[0, 2]
            case.naive_fails(worst((np.arctan(np.hypot(*a)) * a / np.hypot(*a))[None], expected))
    if point[0, 2] < 0:
        # The definition with atan(r / z), as OpenCV has it, ends at 90 degrees.
        r = np.linalg.norm(point[0, :2])
        theta = np.arctan(r / point[0, 2])
        naive = theta * (1 + sum(k * theta ** (2 * n) for n, k in enumerate(TERMS, 1))) * point[0, :2] / r
        case.naive_fails(worst(naive[None], expected))


def textbook_fisheye(point, terms):
    """With theta = atan(r / z)."""
    r = np.linalg.norm(point[:, :2], axis=1)
    theta = np.arctan(r / point[:, 2])
    return (theta * (1 + sum(k * theta ** (2 * n) for n, k in enumerate(terms, 1))) / r)[:, None] * point[:, :2]


@pytest.mark.parametrize("where", [name for name in ANGLES if "beside" not in name and "behind" not in name])
def test_jacobian_by_differences(case, where):
    """Central differences of 1e-6: errors of 1e-12 (step) and 1e-16 / 1e-6 (rounding), times curvatures of up to 10.

    Nearer to the axis than that they would step across it.
    """
    point, step = point_at(ANGLES[where]), 1e-6
    focal, terms = np.array([[300.0, 310.0]]), TERMS[None]
    _, by_point, by_terms = FISHEYE.jacobian(point, terms, focal)
    error = 0.0
    for found, base, at in ((by_point, point, lambda p: (p, terms)), (by_terms, terms, lambda k: (point, k))):
        for k in range(base.shape[1]):
            moved = step * np.eye(base.shape[1])[k]
            high, low = (focal * FISHEYE.distort(*at(base + sign * moved)) for sign in (1, -1))
            error = max(error, worst(found[..., k], (high - low) / (2 * step), scale=300.0))
    case.check(gradient_error=error, gradient_bound=1e-8)
    if where in ("on the axis", "1e-9 beyond 90 degrees", "120 degrees"):  # r is 0, or z is not above it
        with np.errstate(invalid="ignore"):
            high, low = (focal * textbook_fisheye(point + sign * step * np.eye(3)[2], TERMS) for sign in (1, -1))
        case.naive_fails(worst((high - low) / (2 * step), by_point[..., 2], scale=300.0), "gradient")


def test_straight_behind_is_finite_and_on_the_right_circle(case):
    point = np.array([[0.0, 0.0, -1.5]])
    distorted, by_point, by_terms = FISHEYE.jacobian(point, TERMS[None], np.ones((1, 2)))
    with mpmath.workdps(60):
        radius = float(mpmath.pi * (1 + sum(k * mpmath.pi ** (2 * n) for n, k in enumerate(TERMS, 1))))
    case.check(worst(np.linalg.norm(distorted), radius), 1e-15)
    assert np.isfinite(by_point).all()
    assert np.isfinite(by_terms).all()
    np.testing.assert_array_equal(FISHEYE.distort(point, TERMS), distorted)
    r = np.linalg.norm(point[0, :2])
    with np.errstate(invalid="ignore"):
        case.naive_fails(worst(np.linalg.norm(radius * point[0, :2] / r), radius))


@pytest.mark.parametrize("focal", [1e-6, 1.0, 300.0, 1e9])
def test_rays_return_at_any_focal_length(case, focal):
    """Pixels to rays and back, over the whole sphere but its last hundredth of a degree."""
    angle = np.radians(np.concatenate([[0.0, 1e-12, 1e-6], np.linspace(0.1, 179.99, 400), [90.0]]))
    points = np.concatenate([point_at(a, around=3.0 * a) for a in angle])
    K = np.array([[focal, 0, 0.5], [0, 1.1 * focal, 0.25], [0, 0, 1.0]])
    pixels = FISHEYE.distort(points, TERMS) @ K[:2, :2].T + K[:2, 2]
    rays = FISHEYE.undistort(pixels, K, TERMS)
    # Pixels below a focal length of one are rounded at the size of the principal point.
    case.check(worst(rays, points / 2.0), 1e-13 * max(1.0, 1 / focal))
    case.naive_fails(worst(opencv_rays(pixels, K, TERMS), points / 2.0))


@pytest.mark.parametrize("terms", [FOLDING, np.array([0.2, -0.4, 0.1, 0.0]), np.array([0.0, 0.0, 0.0, -1.0])])
def test_far_corners_where_the_polynomial_has_turned(case, terms):
    """A pixel has the ray before the turn, or none, which is said; cv2.fisheye gives a ray beyond the turn, or -1e6."""
    largest = FISHEYE.largest_angle(terms)
    slope = 1 + sum((2 * n + 1) * k * largest ** (2 * n) for n, k in enumerate(terms, 1))
    assert slope == pytest.approx(0, abs=1e-9)
    before = np.array([0.0, 0.3, 0.9, 0.999, 1 - 1e-9, 1.0]) * largest
    radius = FISHEYE.distort(np.concatenate([point_at(a, around=0.0) for a in before]), terms)[:, 0]
    rays = FISHEYE.undistort(np.stack([radius, 0 * radius], 1), np.eye(3), terms)
    again = FISHEYE.distort(rays, terms)[:, 0]
    case.check(worst(again, radius), 1e-14)
    theirs = opencv_rays(np.stack([radius, 0 * radius], 1), np.eye(3), terms)
    case.naive_fails(worst(theirs, np.stack([np.sin(before), 0 * before, np.cos(before)], 1)))
    assert (np.arctan2(rays[:, 0], rays[:, 2]) <= largest * (1 + 1e-15)).all()
    beyond = radius[-1] * np.array([1 + 1e-12, 1.5, 100.0, 1e300])
    assert np.isnan(FISHEYE.undistort(np.stack([0 * beyond, beyond], 1), np.eye(3), terms)).all()
    folded = np.concatenate([point_at(largest * factor) for factor in (1 + 1e-9, 1.2)])
    assert not FISHEYE.sees(folded, terms).any()
    assert FISHEYE.sees(point_at(largest * (1 - 1e-9)), terms).all()


def test_perspective_lens_beyond_its_turn_is_finite():
    """x (1 - 0.4 x^2) has its largest value, 0.61, at 0.91: the corners of this image have no ray."""
    terms = np.array([-0.4, 0.0, 0.0, 0.0, 0.0])
    pixels = np.array([[0.6, 0.0], [0.61, 0.0], [1.0, 1.0], [50.0, -20.0], [1e6, 0.0]])
    assert np.isfinite(BROWN_CONRADY.undistort(pixels, np.eye(3), terms)).all()


def fisheye_camera(focal=60.0, terms=TERMS, size=(200, 160)):
    K = np.array([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1]])
    return Camera(np.eye(3), np.zeros(3), K, terms, *size, FISHEYE)


def test_pinhole_coordinates_end_at_90_degrees(case):
    camera = fisheye_camera()
    angle = np.radians([0.0, 30.0, 89.0, 89.999, 90.0, 90.001, 120.0])
    points = np.concatenate([point_at(a) for a in angle])
    points[4] = point_at(None)
    xy = camera.undistort(camera.project(points)[0])
    expected = points[:4, :2] / points[:4, 2:]
    # Near 90 degrees an angle's rounding grows by 1 / cos^2: 1e-16 / 3e-10.
    case.check(worst(xy[:4], expected), 1e-6)
    assert np.isnan(xy[4:]).all()
    directions = camera.ray_directions(camera.project(points)[0])
    np.testing.assert_allclose(directions, points / 2.0, atol=1e-13)


@pytest.mark.parametrize("terms", [TERMS, FOLDING])
@pytest.mark.parametrize("focal", [5.0, 60.0, 1e4])
def test_undistorted_images_are_finite_and_masked_where_nothing_is_seen(case, terms, focal):
    """5 pixels: 180 degrees are 16 pixels of the image, and its pinhole looks up to 87 degrees aside."""
    camera = fisheye_camera(focal, terms)
    whole = Box(0, 0, camera.width, camera.height)
    assert np.isfinite(distorted_positions(camera, whole)).all()
    image = np.random.default_rng(0).uniform(size=(camera.height, camera.width, 2)).astype(np.float32)
    assert np.isfinite(undistort_image(image, camera, whole)).all()
    seen, mask = seen_pixels(camera, whole), undistort_mask(np.ones((camera.height, camera.width), np.float32), camera)
    np.testing.assert_array_equal(mask > 0, seen)
    x, y = (np.mgrid[0 : camera.width, 0 : camera.height].swapaxes(1, 2) + 0.5) - np.array([100, 80])[:, None, None]
    beyond = np.arctan(np.hypot(x, y) / focal) > FISHEYE.largest_angle(terms)
    case.check(np.mean(seen == beyond), 0)
    if beyond.any():  # All that lands on the image, as a map of pixels alone has it.
        rays = np.stack([x / focal, y / focal, np.ones_like(x)], -1).reshape(-1, 3)
        lands = textbook_fisheye(rays, terms) * focal + [100, 80]
        case.naive_fails(np.mean(((lands > 0) & (lands < [200, 160])).all(1) == beyond.ravel()))
    assert 0 <= left_out(camera) <= 1


def test_share_that_a_pinhole_leaves_out(case):
    """An equidistant lens whose image reaches 90 degrees at its side: the pinhole keeps 57.5 degrees each way."""
    camera = fisheye_camera(100 / (np.pi / 2), np.zeros(4), (200, 200))
    u, v = np.meshgrid(*[(np.arange(2000) + 0.5) / 2000 * 2 - 1] * 2)
    angle = np.hypot(u, v) * np.pi / 2
    tangent = np.where(angle < np.pi / 2, np.tan(angle), np.inf) / np.maximum(np.hypot(u, v), 1e-12)
    kept = np.maximum(np.abs(u), np.abs(v)) * tangent <= np.pi / 2
    case.check(abs(left_out(camera) - (1 - kept.mean())), 0.02)


@pytest.mark.parametrize("focal", [1e-3, 300.0, 1e9])
def test_pixels_and_derivatives_scale_with_the_focal_length(case, focal):
    points = np.concatenate([point_at(a) for a in (0.0, 0.5, 1.5, 2.5)])
    intrinsics = np.tile([focal, 1.01, 320.0, 240.0, *TERMS], (4, 1))
    pixel, by_intrinsics, by_point = project_with_jacobian(FISHEYE, intrinsics, points)
    K = np.array([[focal, 0, 319.5], [0, 1.01 * focal, 239.5], [0, 0, 1]])
    front = points[:3, None]
    theirs, _ = cv2.fisheye.projectPoints(front, np.zeros(3), np.zeros(3), K, TERMS)
    assert np.isfinite(by_intrinsics).all()
    assert np.isfinite(by_point).all()
    case.check(worst(pixel[:3], theirs[:, 0] + 0.5, scale=max(focal, 320.0)), 1e-13)
