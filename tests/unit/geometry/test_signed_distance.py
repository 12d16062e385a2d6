"""Outlines against shapes with known distance and area, and the outline term on a planted displacement."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pipeline.geometry.cameras import Camera
from pipeline.geometry.lenses import FISHEYE
from pipeline.geometry.signed_distance import (
    draw_silhouette,
    signed_distance,
    silhouette_overlap,
    view_from_masks,
)
from pipeline.geometry.surface_points import spread_vertices
from pipeline.tracking.silhouette_cue import silhouette_term
from tests.support.figures.walking import draw_mask, mesh, ring_of_cameras


@pytest.fixture
def camera() -> Camera:
    return Camera(np.eye(3), np.zeros(3), np.array([[100.0, 0, 50], [0, 100, 40], [0, 0, 1]]), np.zeros(5), 100, 80)


def on_image(corners: np.ndarray, camera: Camera, depth: float = 2.0) -> np.ndarray:
    """World points that project to given pixels."""
    xy = (corners - camera.K[:2, 2]) / camera.K[0, 0]
    return depth * np.c_[xy, np.ones(len(xy))]


def test_distance_to_a_disc() -> None:
    row, column = np.indices((90, 100)) + 0.5
    truth = 25.3 - np.hypot(column - 48.2, row - 45.1)
    distance = signed_distance(((truth > 0) * 255).astype(np.uint8))
    near = np.abs(truth) < 8
    assert np.abs(distance - truth)[near].max() < 0.6  # a binary mask places its outline to half a pixel
    assert abs((distance - truth)[near].mean()) < 0.05


@pytest.mark.parametrize("factor", [2, 3, 4])
def test_reduced_masks_are_neither_fatter_nor_thinner(factor: int) -> None:
    row, column = np.indices((90 * factor, 100 * factor)) + 0.5
    small_row, small_column = np.indices((90, 100)) + 0.5
    errors = []
    for x, y, radius in np.random.default_rng(0).uniform([40, 40, 10], [50, 50, 30], (8, 3)):
        fine = np.hypot(column / factor - x, row / factor - y) < radius
        reduced = np.round(255 * fine.reshape(90, factor, 100, factor).mean((1, 3))).astype(np.uint8)
        truth = radius - np.hypot(small_column - x, small_row - y)
        errors.append((signed_distance(reduced) - truth)[np.abs(truth) < 1.5])
    # The binary mask's own pixels place its outline to 0.3 of theirs. Ties of half-covered pixels, all taken for
    # inside, would make discs fatter by 0.1 px at factor 2.
    assert abs(np.concatenate(errors).mean()) < 0.04
    assert np.concatenate(errors).std() < 0.15


def test_a_mesh_is_compared_with_binary_masks_as_a_binary_mask(camera: Camera) -> None:
    corners = on_image(np.array([[10.3, 12.4], [71.0, 20.7], [30.5, 66.1]]), camera)
    faces, empty = np.array([[0, 1, 2]]), np.zeros((80, 100), np.uint8)
    partly = draw_silhouette(camera, corners, faces)
    rounded = np.where(partly >= 128, 255, 0).astype(np.uint8)
    for given, expected in (([rounded, empty], rounded), ([rounded, partly], partly)):
        drawing = view_from_masks(camera, given).drawn(*camera.project(corners), faces)
        (top, left), (rows, columns) = drawing.corner, drawing.mask.shape
        assert (drawing.mask == expected[top : top + rows, left : left + columns]).all()
        assert drawing.mask.sum(dtype=int) == expected.sum(dtype=int)


def slow_distance(mask: np.ndarray) -> np.ndarray:
    """`signed_distance`, step by step over whole images."""
    inside, full = mask >= 128, (mask == 255).astype(np.uint8)
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    beside_empty = cv2.erode((mask > 0).astype(np.uint8), cross, borderType=cv2.BORDER_REPLICATE) == 0
    edge = (mask > 0) & ((full == 0) | beside_empty)
    away, nearest = cv2.distanceTransformWithLabels(
        (~edge).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE, labelType=cv2.DIST_LABEL_PIXEL
    )
    offset = np.zeros(nearest.max() + 1, np.float32)
    offset[nearest[edge]] = mask[edge] / np.float32(255) - np.float32(0.5)
    distance = np.where(inside, away, -away) + offset[nearest]
    return cv2.GaussianBlur(np.clip(distance, -30, 30).astype(np.float32), (0, 0), 0.7)


def test_distances_are_those_of_whole_image_steps() -> None:
    random, row, column = np.random.default_rng(0), *np.indices((60, 70))
    for _ in range(20):
        disc = np.clip(random.uniform(5, 40) - np.hypot(row - 30, column - random.uniform(0, 70)), 0, 1)
        for mask in (255 * disc, 255 * (disc > 0.5), random.integers(0, 256, disc.shape)):
            whole = np.round(mask).astype(np.uint8)
            assert (signed_distance(whole) == slow_distance(whole)).all()


def test_empty_and_full_masks_stay_finite(camera: Camera) -> None:
    for value in (0, 255):
        assert np.isfinite(signed_distance(np.full((80, 100), value, np.uint8))).all()
    view = view_from_masks(camera, [None, np.zeros((80, 100), np.uint8), np.full((80, 100), 255, np.uint8)])
    assert view.usable.tolist() == [False, False, True]


def test_drawn_coverage_is_the_area(camera: Camera) -> None:
    corners = np.array([[10.25, 12.5], [71.0, 20.75], [30.5, 66.0]])
    area = 0.5 * abs(np.linalg.det(corners[1:] - corners[0]))
    for faces in ([[0, 1, 2]], [[2, 1, 0]]):
        drawn = draw_silhouette(camera, on_image(corners, camera), np.array(faces))
        assert drawn.sum() / 255 == pytest.approx(area, rel=0.01)


def test_drawing_agrees_with_opencv_on_a_body() -> None:
    vertices, faces, _ = mesh()
    for camera in ring_of_cameras(3).values():
        small = camera.downsampled(4.0)
        ours, theirs = (f(small, vertices, faces).astype(int) for f in (draw_silhouette, draw_mask))
        # OpenCV fills the outline's own pixels too, at eight times the resolution: a tenth of a pixel of outline.
        assert np.abs(ours - theirs).sum() / theirs.sum() < 0.05


def test_degenerate_and_hidden_triangles_are_left_out(camera: Camera) -> None:
    corners = on_image(np.array([[10.0, 10.0], [60.0, 10.0], [35.0, 10.0], [20.0, 50.0]]), camera)
    corners = np.concatenate([corners, -corners[:3], [[np.nan] * 3]])
    faces = np.array([[0, 1, 2], [0, 0, 3], [4, 5, 6], [0, 1, 7]])
    assert draw_silhouette(camera, corners, faces).max() == 0


def test_overlap_counts_pixels(camera: Camera) -> None:
    corners = on_image(np.array([[10.0, 10], [50, 10], [50, 50], [10, 50]]), camera)
    faces, mask = np.array([[0, 1, 2], [0, 2, 3]]), np.zeros((80, 100), np.uint8)
    mask[10:50, 20:60] = 255
    view = view_from_masks(camera, [mask, None])
    overlap = silhouette_overlap([view], np.stack([corners, corners]), faces)
    assert overlap[0] == pytest.approx(30 / 50)
    assert np.isnan(overlap[1])


def fisheyes_aside(count: int) -> list[Camera]:
    """Fisheyes that see the figure 35 degrees from their axis, where a pinhole's slope is a third too steep."""
    aside = cv2.Rodrigues(np.radians([0.0, 35.0, 0.0]))[0]
    K, terms = np.array([[130.0, 0, 100], [0, 130, 80], [0, 0, 1]]), np.array([-0.03, 0.01, 0.0, 0.0])
    ring = ring_of_cameras(count).values()
    return [Camera(aside @ c.R, aside @ c.t, K, terms, 200, 160, FISHEYE) for c in ring]


@pytest.mark.parametrize("lens", ["perspective", "fisheye"])
def test_silhouette_term_pulls_back_and_knows_its_slope(lens: str) -> None:
    vertices, faces, _ = mesh()
    cameras = [c.downsampled(4.0) for c in ring_of_cameras(4).values()] if lens == "perspective" else fisheyes_aside(4)
    views = [view_from_masks(c, [draw_mask(c, vertices, faces)]) for c in cameras]
    chosen, shift = spread_vertices(vertices, 200), np.array([0.012, -0.008, 0.01])
    moved = (vertices + shift)[None]
    term = silhouette_term(views, moved, faces, chosen, 1.0)
    quadratic = term(moved[:, chosen])
    step = np.linalg.solve(quadratic.normal.sum((0, 1)), -quadratic.gradient.sum((0, 1)))
    assert np.linalg.norm(step + shift) < 0.3 * np.linalg.norm(shift)
    for axis in range(3):
        nudge = 1e-5 * np.eye(3)[axis]
        slope = (term(moved[:, chosen] + nudge).cost - term(moved[:, chosen] - nudge).cost) / 2e-5
        # The term leaves lens distortion out of its derivative: a few percent of the largest component.
        scale = np.abs(quadratic.gradient.sum((0, 1))).max()
        assert abs(slope - quadratic.gradient.sum((0, 1))[axis]) < 0.1 * scale


def test_spread_vertices_cover_the_mesh() -> None:
    vertices = np.random.default_rng(0).uniform(size=(2000, 3))
    vertices[:1500] *= 0.1  # a dense corner must not take most of them
    chosen = spread_vertices(vertices, 100)
    assert len(set(chosen)) == 100
    nearest = np.linalg.norm(vertices[:, None] - vertices[chosen][None], axis=-1).min(1)
    assert nearest.max() < 0.2
    assert len(spread_vertices(np.zeros((5, 3)), 4)) == 1


def test_mask_without_outline_is_far_inside_or_far_outside() -> None:
    """Positive inside: a subject that fills the image is not beside it."""
    shape = (20, 30)
    assert (signed_distance(np.full(shape, 255, np.uint8)) > 10).all()
    assert (signed_distance(np.zeros(shape, np.uint8)) < -10).all()
