"""Drawn triangles against a test of every sample of the image, one at a time."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.geometry.raster_kernels import SUPERSAMPLING, drawn_window, fill_coverage, fill_depth
from tests.support.figures.walking import mesh, ring_of_cameras

HEIGHT, WIDTH = 48, 40


def shares(corners: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Barycentric coordinates [3, rows, columns] of the points (x, y) in a triangle [3, 2]."""
    edges = np.roll(corners, -1, 0) - corners
    area = np.linalg.det(corners[1:] - corners[0])
    with np.errstate(over="ignore", invalid="ignore"):
        opposite = [
            edges[a, 0] * (y[:, None] - corners[a, 1]) - edges[a, 1] * (x[None] - corners[a, 0]) for a in (1, 2, 0)
        ]
    return np.stack(opposite) / area


def drawn(pixels: np.ndarray, depth: np.ndarray, faces: np.ndarray) -> list[np.ndarray]:
    """The triangles that are drawn, as rows x, y, depth of their corners."""
    corners = np.concatenate([pixels, depth[:, None]], 1)[faces]
    return [c for c in corners if (c[:, 2] > 0).all() and np.isfinite(c).all() and np.linalg.det(c[1:, :2] - c[0, :2])]


def slow_coverage(pixels: np.ndarray, depth: np.ndarray, faces: np.ndarray) -> np.ndarray:
    x, y = ((np.arange(size * SUPERSAMPLING) + 0.5) / SUPERSAMPLING for size in (WIDTH, HEIGHT))
    filled = np.zeros((len(y), len(x)), bool)
    for corners in drawn(pixels, depth, faces):
        filled |= (shares(corners[:, :2], x, y) >= 0).all(0)
    blocks = filled.reshape(HEIGHT, SUPERSAMPLING, WIDTH, SUPERSAMPLING).mean((1, 3))
    return np.floor(255 * blocks + 0.5).astype(np.uint8)


def slow_depth(pixels: np.ndarray, depth: np.ndarray, faces: np.ndarray) -> np.ndarray:
    nearest = np.full((HEIGHT, WIDTH), np.inf)
    for corners in drawn(pixels, depth, faces):
        share = shares(corners[:, :2], np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
        with np.errstate(divide="ignore"):
            here = 1 / np.tensordot(1 / corners[:, 2], share, 1)
        nearest = np.where((share >= 0).all(0), np.minimum(nearest, here), nearest)
    return nearest


def scattered(seed: int, spread: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Triangles of any size, in the image and beside it, some behind the camera, some not finite."""
    random = np.random.default_rng(seed)
    center = random.uniform(-20, 60, (60, 1, 2))
    pixels = (center + spread * random.normal(size=(60, 3, 2))).reshape(-1, 2)
    depth = random.uniform(-0.1, 3.0, len(pixels))
    pixels[7], pixels[11], pixels[15] = np.nan, np.inf, 1e300
    faces = np.concatenate([np.arange(180).reshape(-1, 3), random.integers(0, 180, (20, 3)), [[0, 0, 1]]])
    return pixels, depth, faces.astype(np.int64)


@pytest.mark.parametrize("spread", [0.3, 2.0, 30.0])
def test_drawn_triangles_are_those_of_every_sample(spread: float) -> None:
    for seed in range(5):
        scene = scattered(seed, spread)
        assert (fill_coverage(*scene, (0, 0, HEIGHT, WIDTH)) == slow_coverage(*scene)).all()
        assert np.allclose(fill_depth(*scene, HEIGHT, WIDTH), slow_depth(*scene), rtol=1e-5, atol=0)


def test_a_window_holds_all_that_is_drawn() -> None:
    vertices, faces, _ = mesh()
    for camera in ring_of_cameras(3).values():
        pixels, depth = camera.downsampled(4.0).project(vertices)
        for shift in ([0, 0], [70, 0], [-60, 40], [0, -500]):
            whole = fill_coverage(pixels + shift, depth, faces, (0, 0, 192, 160))
            top, left, bottom, right = drawn_window(pixels + shift, depth, faces, 192, 160, 8)
            part = fill_coverage(pixels + shift, depth, faces, (top, left, bottom, right))
            assert (part == whole[top:bottom, left:right]).all()
            assert part.sum(dtype=int) == whole.sum(dtype=int)


def test_nothing_drawn_has_an_empty_window() -> None:
    top, left, bottom, right = drawn_window(np.ones((3, 2)), -np.ones(3), np.array([[0, 1, 2]]), 48, 40, 8)
    assert (bottom - top) * (right - left) == 0
