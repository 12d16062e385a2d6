"""The ellipsoid that stands in for the subject: found from its outlines, bright as theory says."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from pipeline.geometry.cameras import Camera
from pipeline.sync.subject_proxy import BOUNCED, Ellipsoid, fit_ellipsoid, shading_response, subject_center
from tests.support.rigs.light_stage import traced_transport


def look_at(center: np.ndarray, target: np.ndarray, focal: float) -> Camera:
    forward = (target - center) / np.linalg.norm(target - center)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(forward, right), forward])
    K = np.array([[focal, 0, 100.0], [0, focal, 100], [0, 0, 1]])
    return Camera(R, -R @ center, K, np.zeros(5), 200, 200)


def ring(count: int, distance: float, target: np.ndarray, focal: float) -> dict[str, Camera]:
    angles = 2 * np.pi * np.arange(count) / count
    heights = np.where(np.arange(count) % 2, 0.1, 0.4)
    places = distance * np.stack([np.sin(angles), heights, np.cos(angles)], 1)
    return {str(i): look_at(target + place, target, focal) for i, place in enumerate(places)}


def outline(camera: Camera, ellipsoid: Ellipsoid) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of the pixels whose rays meet the ellipsoid."""
    y, x = np.mgrid[0:200, 0:200] + 0.5
    pixels = np.stack([x.ravel(), y.ravel()], 1)
    inverse = np.linalg.inv(ellipsoid.axes)
    start, ray = inverse @ (camera.center - ellipsoid.center), camera.ray_directions(pixels) @ inverse.T
    a, b, c = (ray**2).sum(1), ray @ start, start @ start - 1
    inside = pixels[b**2 >= a * c]
    return inside.mean(0), np.cov(inside.T, bias=True)


def test_subject_center_is_where_the_rays_meet():
    target = np.array([0.2, 1.1, -0.3])
    cameras = ring(3, 4.0, np.zeros(3), 200.0)
    pixels = {name: camera.project(target)[0] for name, camera in cameras.items()}
    np.testing.assert_allclose(subject_center(cameras, pixels), target, atol=1e-9)
    assert np.isfinite(subject_center(cameras, {"0": pixels["0"]})).all()


def test_an_ellipsoid_is_found_from_its_outlines():
    turn = np.array([[0.8, 0, 0.6], [0, 1, 0], [-0.6, 0, 0.8]])
    true = Ellipsoid(np.array([0.1, 0.9, 0.0]), turn @ np.diag([0.2, 0.8, 0.35]))
    cameras = ring(6, 12.0, true.center, 1000.0)
    outlines = {name: outline(camera, true) for name, camera in cameras.items()}
    found = fit_ellipsoid(cameras, {n: m for n, (m, _) in outlines.items()}, {n: c for n, (_, c) in outlines.items()})
    # Perspective at 12 m, and outlines of whole pixels: percents.
    np.testing.assert_allclose(found.center, true.center, atol=0.01)
    np.testing.assert_allclose(found.axes @ found.axes.T, true.axes @ true.axes.T, atol=0.02)


def test_one_camera_leaves_a_sound_ellipsoid():
    true = Ellipsoid(np.zeros(3), np.diag([0.2, 0.8, 0.35]))
    cameras = ring(1, 12.0, true.center, 1000.0)
    mean, covariance = outline(cameras["0"], true)
    lengths = np.linalg.norm(fit_ellipsoid(cameras, {"0": mean}, {"0": covariance}).axes, axis=0)
    assert lengths.max() == pytest.approx(0.8, rel=0.1)
    assert lengths.min() >= 0.15 * lengths.max()


def test_without_masks_the_subject_is_a_small_ball():
    cameras = ring(3, 4.0, np.zeros(3), 200.0)
    found = fit_ellipsoid(
        cameras, dict.fromkeys(cameras, np.array([100.0, 100])), dict.fromkeys(cameras, np.full((2, 2), np.nan))
    )
    np.testing.assert_allclose(found.axes, 0.01 * np.eye(3))


def test_a_small_sphere_has_the_phases_of_lamberts():
    """Mean over the disc of a Lambert sphere at phase angle a: 2 / (3 pi) (sin a + (pi - a) cos a), times 1 / d^2."""
    sphere = Ellipsoid(np.zeros(3), 0.01 * np.eye(3))
    angles = np.radians([0.0, 30, 60, 90, 120, 180])
    lights = 2.0 * np.stack([np.sin(angles), np.zeros(6), np.cos(angles)], 1)
    cameras = np.array([[0.0, 0, 3.0], [0.0, 0, -3.0]])

    def phase(a: np.ndarray) -> np.ndarray:
        return 2 / (3 * np.pi) * (np.sin(a) + (np.pi - a) * np.cos(a)) / 4

    direct = np.stack([phase(angles), phase(np.pi - angles)])
    expected = (1 - BOUNCED) * direct + BOUNCED * direct.mean(0)
    np.testing.assert_allclose(shading_response(sphere, lights, cameras), expected, atol=0.01 * expected.max())


def test_a_tall_subject_is_as_bright_as_a_traced_mesh():
    """Near lights, one of them level with the head; a convex body shades itself by its horizon alone."""
    tall = Ellipsoid(np.zeros(3), np.diag([0.25, 0.9, 0.2]))
    mesh = trimesh.creation.icosphere(subdivisions=4)
    mesh.apply_transform(np.diag([0.25, 0.9, 0.2, 1.0]))
    lights = np.array([[0.0, 0.9, 1.0], [1.5, 0, 0], [0, 2.0, 0.3], [-0.5, -0.5, -1.5]])
    cameras = np.array([[0.0, 0, 2.5], [2.0, 1.0, -1.0]])
    direct = traced_transport(mesh, lights, cameras)
    expected = (1 - BOUNCED) * direct + BOUNCED * direct.mean(0)
    np.testing.assert_allclose(shading_response(tall, lights, cameras), expected, atol=0.02 * expected.max())
