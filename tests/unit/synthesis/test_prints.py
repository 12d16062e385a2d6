"""Prints against exact geometry, and against the same prints path-traced."""

import numpy as np
import pytest

from pipeline.geometry.cameras import Camera
from pipeline.synthesis import mitsuba_scenes as scenes
from pipeline.synthesis.lens import view_points
from pipeline.synthesis.prints import render_print
from pipeline.synthesis.stage_rig import look_at

CENTER = np.array([0.5, 0.4, 2.2])
SQUARE = np.array([[-0.5, 0.5, 0.0], [0.5, 0.5, 0.0], [0.5, -0.5, 0.0], [-0.5, -0.5, 0.0]])


@pytest.fixture(scope="module")
def camera():
    R = look_at(CENTER, np.zeros(3), roll=0.1)
    K = np.array([[130.0, 0, 47], [0, 131, 51], [0, 0, 1]])
    return Camera(R, -R @ CENTER, K, np.array([-0.08, 0.02, 0.001, 0.002, 0.0]), 96, 100)


def test_print_lies_where_the_distorted_camera_sees_it(camera):
    texture = np.full((40, 40, 2), 0.1, dtype=np.float32)
    texture[:20, 20:, 0] = 0.8  # top right
    texture[..., 1] = 1  # what the print covers
    view = view_points(camera, SQUARE, 4)
    image = view.develop(render_print(texture, SQUARE, view))
    corners, _ = camera.project(np.array([[0.25, 0.25, 0], [-0.25, 0.25, 0], [-0.25, -0.25, 0], [0.25, -0.25, 0.0]]))
    values = image[corners[:, 1].astype(int), corners[:, 0].astype(int), 0]
    np.testing.assert_allclose(values, [0.8, 0.1, 0.1, 0.1], atol=1e-5)
    # The bright quarter's centroid, found in the image, against the exact one of a fine grid on the plane.
    grid = np.stack(np.meshgrid(np.linspace(0, 0.5, 200), np.linspace(0, 0.5, 200), [0.0]), axis=-1).reshape(-1, 3)
    expected = area_weighted_mean(camera, grid)
    weight = np.clip(image[..., 0] - 0.1 * image[..., 1], 0, None)
    rows, columns = np.mgrid[: weight.shape[0], : weight.shape[1]]
    found = np.array([(weight * columns).sum(), (weight * rows).sum()]) / weight.sum() + 0.5
    # Samples on a grid along about 60 edge pixels leave some hundredths of a pixel.
    np.testing.assert_allclose(found, expected, atol=0.03)


def area_weighted_mean(camera, points):
    """Mean image position of a plane patch z = 0, each point weighted by the image area around it."""
    step = 1e-4
    here, _ = camera.project(points)
    right, _ = camera.project(points + np.array([step, 0, 0]))
    up, _ = camera.project(points + np.array([0, step, 0]))
    a, b = right - here, up - here
    area = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    return (area[:, None] * here).sum(axis=0) / area.sum()


def traced_print(texture, corners):
    """A Mitsuba scene of a rectangle that emits the texture."""
    mi = scenes.mitsuba()
    uv = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    light = {"type": "area", "radiance": scenes.bitmap_texture(texture, "nearest")}
    mesh = scenes.triangle_mesh({"type": "diffuse"}, corners, np.array([[0, 2, 1], [0, 3, 2]]), uv, emitter=light)
    return mi.load_dict({"type": "scene", "integrator": {"type": "path", "max_depth": 1}, "print": mesh})


def test_print_is_what_path_tracing_makes_of_it(camera):
    pytest.importorskip("mitsuba")
    texture = np.random.default_rng(3).uniform(0, 1, (30, 30, 3)).astype(np.float32)
    view = view_points(camera, SQUARE, 2)
    traced = view.develop(scenes.render(traced_print(texture, SQUARE), view, 256, seed=0))[..., :3]
    errors = [np.abs(view.develop(render_print(texture, SQUARE, view, grid)) - traced) for grid in (3, 16)]
    inside = traced.min(axis=-1) > 0
    assert inside.sum() > 1000
    # A grid of n x n places an edge within half a step: over two fine pixels and texels that differ by 1/3, 0.3 / n.
    assert errors[0].mean() < 0.1 / 3 and errors[1].mean() < 0.1 / 16
    assert errors[1].max() < 0.06
