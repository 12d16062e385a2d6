"""Lenses against OpenCV and pycolmap, and what every lens of the registry must keep."""

from __future__ import annotations

import cv2
import numpy as np
import pycolmap
import pytest

from pipeline.geometry.cameras import Camera, project_with_jacobian, read_cameras, write_cameras
from pipeline.geometry.lenses import BROWN_CONRADY, FISHEYE, LENSES

TERMS = {
    "brown_conrady": np.array([-0.2, 0.1, 1e-2, -1e-2, 0.05]),
    "fisheye": np.array([-0.03, 0.012, -0.005, 0.0007]),
}
K = np.array([[700.0, 0, 310], [0, 707, 250], [0, 0, 1]])


def rays(count, widest_deg, seed=0):
    """Directions of any length within an angle of the optical axis."""
    rng = np.random.default_rng(seed)
    theta, phi = np.radians(widest_deg) * np.sqrt(rng.uniform(size=count)), rng.uniform(0, 2 * np.pi, count)
    directions = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], 1)
    return rng.uniform(0.5, 5, (count, 1)) * directions


def test_fisheye_projects_as_opencv():
    points, terms = rays(300, 89.5), TERMS["fisheye"]
    opencv_K = K - np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    theirs, _ = cv2.fisheye.projectPoints(points[:, None], np.zeros(3), np.zeros(3), opencv_K, terms)
    ours = Camera(np.eye(3), np.zeros(3), K, terms, 640, 480, FISHEYE).project(points)[0]
    np.testing.assert_allclose(ours, theirs[:, 0] + 0.5, atol=1e-9)


def test_fisheye_undistorts_as_colmap():
    points, terms = rays(300, 89.0), TERMS["fisheye"]
    theirs = pycolmap.Camera(model="OPENCV_FISHEYE", width=640, height=480, params=[700, 707, 310, 250, *terms])
    pixels = theirs.img_from_cam(points)
    ours = Camera(np.eye(3), np.zeros(3), K, terms, 640, 480, FISHEYE).ray_directions(pixels)
    np.testing.assert_allclose(ours, points / np.linalg.norm(points, axis=1, keepdims=True), atol=1e-9)


@pytest.mark.parametrize("name", LENSES)
class TestEveryLens:
    def test_undistorting_undoes_distorting(self, name):
        lens, terms = LENSES[name], TERMS[name]
        points = rays(200, 25.0 if lens.perspective else 150.0)
        pixels = lens.distort(points, terms) @ K[:2, :2].T + K[:2, 2]
        found = lens.undistort(pixels, K, terms)
        found /= np.linalg.norm(found, axis=1, keepdims=True)
        np.testing.assert_allclose(found, points / np.linalg.norm(points, axis=1, keepdims=True), atol=1e-9)

    def test_jacobian_by_differences(self, name):
        lens = LENSES[name]
        points = rays(20, 25.0 if lens.perspective else 150.0)
        intrinsics = np.tile([700.0, 1.01, 310, 250, *TERMS[name]], (20, 1))
        pixel, by_intrinsics, by_point = project_with_jacobian(lens, intrinsics, points)
        ours = Camera(np.eye(3), np.zeros(3), K, TERMS[name], 640, 480, lens).project(points)[0]
        np.testing.assert_allclose(pixel, ours, atol=1e-9)
        for arguments, jacobian, which in ((intrinsics, by_intrinsics, 0), (points, by_point, 1)):
            for k in range(arguments.shape[1]):
                step = 1e-6 * max(1.0, abs(arguments[0, k]))
                moved = step * np.eye(arguments.shape[1])[k]
                pair = [
                    (arguments + sign * moved, points) if which == 0 else (intrinsics, arguments + sign * moved)
                    for sign in (1, -1)
                ]
                high, low = (project_with_jacobian(lens, *each)[0] for each in pair)
                assert jacobian[..., k] == pytest.approx((high - low) / (2 * step), rel=1e-5, abs=1e-4)

    def test_derivative_by_world_points_by_differences(self, name):
        lens = LENSES[name]
        R = cv2.Rodrigues(np.array([0.3, -0.2, 0.5]))[0]
        camera = Camera(R, np.array([0.1, -0.2, 0.3]), K, TERMS[name], 640, 480, lens)
        points = (rays(20, 25.0 if lens.perspective else 120.0) - camera.t) @ R
        pixels, by_point = camera.project_with_derivative(points)
        np.testing.assert_allclose(pixels, camera.project(points)[0], atol=1e-9)
        for k, step in enumerate(1e-6 * np.eye(3)):
            numeric = (camera.project(points + step)[0] - camera.project(points - step)[0]) / 2e-6
            assert by_point[..., k] == pytest.approx(numeric, rel=1e-5, abs=1e-4)

    def test_without_faults_small_angles_are_a_pinholes(self, name):
        lens, points = LENSES[name], rays(50, 0.01)
        found = lens.distort(points, lens.no_distortion())
        # A fisheye's theta falls short of tan theta by theta^3 / 3: 2e-12 at 0.01 degrees.
        np.testing.assert_allclose(found, points[:, :2] / points[:, 2:], atol=1e-11)

    def test_counts_and_priors_are_of_its_terms(self, name):
        lens = LENSES[name]
        assert lens.name == name
        assert len(lens.prior_sigma) == len(lens.terms) == lens.term_counts[-1]
        assert min(lens.prior_sigma) > 0
        assert list(lens.term_counts) == sorted(set(lens.term_counts))

    def test_camera_of_this_lens_survives_its_file(self, name, tmp_path):
        camera = Camera(np.eye(3), np.array([0.1, 0.2, 3.0]), K, TERMS[name], 640, 480, LENSES[name])
        write_cameras(tmp_path / "cameras.json", {"a": camera})
        again = read_cameras(tmp_path / "cameras.json")["a"]
        assert again.lens is camera.lens
        np.testing.assert_array_equal(again.dist, camera.dist)
        assert ('"lens"' in (tmp_path / "cameras.json").read_text()) == (camera.lens is not BROWN_CONRADY)

    def test_wrong_number_of_coefficients_is_refused(self, name):
        with pytest.raises(ValueError, match="dist: expected the coefficients k1, k2"):
            Camera(np.eye(3), np.zeros(3), K, np.zeros(7), 640, 480, LENSES[name])


def test_pinhole_of_a_fisheye_is_perspective():
    camera = Camera(np.eye(3), np.zeros(3), K, TERMS["fisheye"], 640, 480, FISHEYE).pinhole()
    assert camera.lens is BROWN_CONRADY
    assert not camera.dist.any()
