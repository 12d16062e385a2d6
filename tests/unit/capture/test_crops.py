"""Crops see what a pinhole camera would: planted points, colours and holes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.capture.crops import cut_crop, foreground_box, mesh_silhouette
from pipeline.geometry.cameras import Camera
from pipeline.geometry.lenses import BROWN_CONRADY, FISHEYE

WIDTH, HEIGHT = 96, 80
COLOR = np.array([[0.9, 0.1, 0.0], [0.05, 1.1, -0.1], [0.0, 0.2, 0.8]])


def distorting_camera() -> Camera:
    K = np.array([[110.0, 0.0, 46.0], [0.0, 112.0, 41.5], [0.0, 0.0, 1.0]])
    return Camera(np.eye(3), np.array([0.0, 0.0, 3.0]), K, np.array([-0.2, 0.05, 0.002, -0.001, 0.0]), WIDTH, HEIGHT)


def blob_at(pixel: np.ndarray, radius: float) -> np.ndarray:
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH] + 0.5
    return np.exp(-((x - pixel[0]) ** 2 + (y - pixel[1]) ** 2) / (2 * radius**2)).astype(np.float32)


def fisheye_camera() -> Camera:
    K = np.array([[110.0, 0.0, 46.0], [0.0, 112.0, 41.5], [0.0, 0.0, 1.0]])
    terms = np.array([-0.03, 0.012, -0.005, 0.0007])
    return Camera(np.eye(3), np.array([0.0, 0.0, 3.0]), K, terms, WIDTH, HEIGHT, FISHEYE)


# A fisheye stretches by 4 tan(theta) per radian: at 18 degrees, blobs of r px lean by 4 * 0.33 r^2 / 110 = 0.01 r^2 px.
@pytest.mark.parametrize(
    ("camera", "radius"), [(distorting_camera(), 2.0), (fisheye_camera(), 1.2)], ids=["perspective", "fisheye"]
)
def test_a_point_of_the_world_is_where_the_crops_own_camera_puts_it(camera, radius):
    for point in (np.array([0.8, 0.5, 0.1]), np.array([-0.9, -0.6, 0.0]), np.array([0.0, 0.1, 0.2])):
        blob = blob_at(camera.project(point)[0], radius)
        crop = cut_crop(np.repeat(blob[..., None], 3, 2), (blob > 0.3).astype(np.float32), camera, margin_px=6)
        weight = crop.image[..., 0] * (crop.image[..., 0] > 0.05)
        y, x = np.mgrid[0 : crop.box.height, 0 : crop.box.width] + 0.5
        found = np.array([(x * weight).sum(), (y * weight).sum()]) / weight.sum()
        # The lens's curvature over a blob of 2 px moves its centroid by hundredths of a pixel; half a pixel would show.
        np.testing.assert_allclose(found, crop.camera.project(point)[0], atol=0.05)
        assert not crop.camera.dist.any()
        assert crop.camera.lens is BROWN_CONRADY
        assert (crop.camera.width, crop.camera.height) == (
            crop.box.width,
            crop.box.height,
        )


def test_without_effects_pixels_are_copied_exactly():
    image = np.random.default_rng(0).normal(size=(HEIGHT, WIDTH, 3)).astype(np.float32)
    mask = np.zeros((HEIGHT, WIDTH), np.float32)
    mask[10:30, 20:60] = 0.7
    crop = cut_crop(image, mask, distorting_camera(), undistort=False, margin_px=3)
    assert (crop.box.x0, crop.box.y0, crop.box.width, crop.box.height) == (17, 7, 46, 26)
    np.testing.assert_array_equal(crop.image, image[7:33, 17:63])
    np.testing.assert_array_equal(crop.mask, mask[7:33, 17:63])
    np.testing.assert_allclose(crop.camera.K[:2, 2], [46.0 - 17, 41.5 - 7])


def test_colors_are_corrected_as_columns():
    image = np.random.default_rng(0).uniform(size=(HEIGHT, WIDTH, 3)).astype(np.float32)
    mask = np.ones((HEIGHT, WIDTH), np.float32)
    crop = cut_crop(image, mask, distorting_camera(), corrected_from_raw=COLOR, undistort=False)
    np.testing.assert_allclose(crop.image[5, 7], COLOR @ image[5, 7], rtol=1e-5)


@pytest.mark.parametrize("undistort", [False, True])
def test_pixels_that_are_not_finite_are_black_and_not_subject(undistort):
    image = np.full((HEIGHT, WIDTH, 3), 0.5, np.float32)
    image[40, 48, 1], image[41, 30, 0] = np.nan, np.inf
    for mask in (np.ones((HEIGHT, WIDTH), np.float32), None):
        crop = cut_crop(image, mask, distorting_camera(), undistort=undistort, silhouette=np.ones_like(image[..., 0]))
        assert np.isfinite(crop.image).all()
        assert crop.mask[38:44, 46:52].min() < 0.5
        assert crop.mask[10:20, 40:50].min() == pytest.approx(1)
        assert (crop.mask < 0.5).sum() < 20 + undistort * 0.2 * crop.mask.size


def test_a_binary_mask_stays_binary_and_a_soft_one_soft():
    camera, image = distorting_camera(), np.ones((HEIGHT, WIDTH, 3), np.float32)
    soft = blob_at(np.array([40.0, 40.0]), 10.0)
    assert set(np.unique(cut_crop(image, (soft > 0.5).astype(np.float32), camera).mask)) == {0, 1}
    assert len(np.unique(cut_crop(image, soft, camera).mask)) > 100


def test_no_foreground_no_crop():
    image = np.ones((HEIGHT, WIDTH, 3), np.float32)
    assert cut_crop(image, np.zeros((HEIGHT, WIDTH), np.float32), distorting_camera()) is None
    assert foreground_box(np.full((4, 4), 0.49), 3) is None


def test_boxes_stay_within_the_image():
    mask = np.zeros((20, 30))
    mask[0, 29] = 1
    box = foreground_box(mask, 5)
    assert (box.x0, box.y0, box.width, box.height) == (24, 0, 6, 6)


def test_silhouette_of_a_sphere_is_its_analytic_outline():
    # An icosphere-like latitude grid, fine enough that its outline is within 0.1 px of the sphere's.
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 65), np.linspace(0, np.pi, 33))
    sphere = 0.5 * np.stack([np.sin(v) * np.cos(u), np.cos(v), np.sin(v) * np.sin(u)], -1).reshape(-1, 3)
    i = (np.arange(32)[:, None] * 65 + np.arange(64)).ravel()
    faces = np.concatenate([np.stack([i, i + 1, i + 65], 1), np.stack([i + 1, i + 66, i + 65], 1)])
    camera = replace(distorting_camera(), dist=np.zeros(5))
    found = mesh_silhouette(sphere.astype(np.float32), faces.astype(np.int32), camera)
    # A pixel's ray hits the sphere if its angle to the centre is below asin(r / d).
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH] + 0.5
    rays = np.stack([(x - 46) / 110, (y - 41.5) / 112, np.ones_like(x)], -1)
    angle = np.arccos(rays[..., 2] / np.linalg.norm(rays, axis=-1))
    edge = np.arcsin(0.5 / 3.0)
    pixel = 1 / 110
    # A pixel is half covered if its centre is inside; the painted outline adds an eighth of a pixel, the grid takes
    # a tenth.
    assert found[angle < edge - 0.2 * pixel].all()
    assert not found[angle > edge + 0.3 * pixel].any()
    distorted = mesh_silhouette(sphere.astype(np.float32), faces.astype(np.int32), distorting_camera())
    np.testing.assert_array_equal(distorted, found)


def test_faces_behind_the_camera_or_far_outside_are_harmless():
    camera = distorting_camera()
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, -5.0], [1e9, 0, 0], [0, 1e9, 0], [2e9, 1e9, 0]], np.float32)
    assert not mesh_silhouette(vertices, np.array([[0, 1, 2]], np.int32), camera).any()
    assert not mesh_silhouette(vertices, np.array([[3, 4, 5]], np.int32), camera)[:, : WIDTH // 2].all()


@pytest.mark.parametrize(("share", "covered"), [(0.2, False), (0.8, True)])
def test_silhouette_takes_pixels_that_are_covered_by_half_on_every_side(share: float, covered: bool) -> None:
    """A square whose outermost pixels it covers by a share, left, right, above and below."""
    camera = Camera(np.eye(3), np.zeros(3), np.array([[10.0, 0, 0], [0, 10, 0], [0, 0, 1]]), np.zeros(5), 32, 24)
    low, high = 6 - share, 15 + share
    corners = np.array([[low, low], [high, low], [high, high], [low, high]])
    vertices = np.concatenate([corners / 10, np.ones((4, 1))], 1)
    mask = mesh_silhouette(vertices, np.array([[0, 1, 2], [0, 2, 3]]), camera)
    rows, columns = np.nonzero(mask)
    expected = (5, 15) if covered else (6, 14)
    assert (rows.min(), rows.max()) == (columns.min(), columns.max()) == expected
