"""Rendered pictures against closed forms: radiometry of a Lambertian plane, geometry of prints and the mirror ball."""

import numpy as np
import pytest

from pipeline.geometry.cameras import Camera
from pipeline.synthesis import mitsuba_scenes as scenes
from pipeline.synthesis.lens import view_points
from pipeline.synthesis.stage_rig import look_at
from pipeline.synthesis.targets import reflections, sphere_points

pytest.importorskip("mitsuba")

CENTER = np.array([0.5, 0.4, 2.2])
SQUARE = np.array([[-0.5, 0.5, 0.0], [0.5, 0.5, 0.0], [0.5, -0.5, 0.0], [-0.5, -0.5, 0.0]])
FACES = np.array([[0, 2, 1], [0, 3, 2]])
UV = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


@pytest.fixture(scope="module")
def camera():
    R = look_at(CENTER, np.zeros(3), roll=0.1)
    K = np.array([[130.0, 0, 47], [0, 131, 51], [0, 0, 1]])
    return Camera(R, -R @ CENTER, K, np.array([-0.08, 0.02, 0.001, 0.002, 0.0]), 96, 100)


def on_plane(camera, pixels):
    """World points where the rays of pixels meet z = 0."""
    directions = camera.ray_directions(pixels)
    return camera.center - camera.center[2] / directions[:, 2:] * directions


def test_lambertian_plane_reflects_inverse_square_light(camera):
    reflectance, light, intensity = 0.4, np.array([0.3, 0.6, 1.1]), 5.0
    mesh = scenes.triangle_mesh({"type": "diffuse", "reflectance": reflectance}, SQUARE, FACES, UV)
    scene = scenes.lit_scene([mesh], light[None], np.array([intensity]), max_depth=4)
    view = view_points(camera, SQUARE, 2)
    image = view.develop(scenes.render(scene, view, 4, seed=3))
    pixels = np.array([[47.5, 50.5], [40.5, 61.5], [60.5, 40.5], [35.5, 45.5]])
    to_light = light - on_plane(camera, pixels)
    distance = np.linalg.norm(to_light, axis=1)
    expected = intensity * reflectance / np.pi * (to_light[:, 2] / distance) / distance**2
    found = image[(pixels[:, 1] - 0.5).astype(int), (pixels[:, 0] - 0.5).astype(int)]
    # Irradiance varies by 1 % over a pixel, which the average over it and the samples' positions blur.
    np.testing.assert_allclose(found[:, 1], expected, rtol=0.01)
    np.testing.assert_allclose(found[:, 3], 1)


def test_lights_one_by_one_add_up_with_less_noise(camera):
    lights, intensities = np.array([[0.3, 0.6, 1.1], [-0.8, 0.1, 0.9], [0.1, -0.9, 0.5]]), np.array([2.0, 3.0, 0.5])
    view = view_points(camera, SQUARE, 1)
    mesh = scenes.triangle_mesh({"type": "diffuse", "reflectance": 0.5}, SQUARE, FACES, UV)
    together = scenes.lit_scene([mesh], lights, intensities, 2)
    single = [scenes.lit_scene([mesh], lights[i : i + 1], intensities[i : i + 1], 2) for i in range(3)]
    true = sum(scenes.render(scene, view, 64, seed=7) for scene in single)
    true[..., 3] /= 3
    drawn = scenes.render(together, view, 12, seed=1)
    alone = scenes.lit_scene([mesh], lights[:1], np.ones(1), 2)
    each = scenes.render_each_light(alone, view, lights, intensities, 4, seed=1)
    inside = (true[..., 3] == 1) & (each[..., 3] == 1)
    assert inside.sum() > 500
    # Light varies by 1 % over a pixel, of which four and 64 places are looked at.
    np.testing.assert_allclose(each[inside], true[inside], rtol=0.01)
    assert np.abs(drawn[inside] / true[inside] - 1).max() > 0.05
    np.testing.assert_allclose(each[..., 3], true[..., 3], atol=0.3)  # edges, by four places in a pixel


def test_intensities_add(camera):
    lights = np.array([[0.3, 0.6, 1.1], [-0.8, 0.1, 0.9]])
    view = view_points(camera, SQUARE, 1)

    def mean(intensities):
        mesh = scenes.triangle_mesh({"type": "diffuse", "reflectance": 0.5}, SQUARE, FACES, UV)
        return scenes.render(scenes.lit_scene([mesh], lights, intensities, 2), view, 64, seed=1)[..., 1].mean()

    separate = mean(np.array([2.0, 0.0])) + mean(np.array([0.0, 3.0]))
    # 64 stratified samples of which light to look at, averaged over about 3000 pixels.
    assert mean(np.array([2.0, 3.0])) == pytest.approx(separate, rel=0.005)


def test_mirror_ball_shows_the_light_where_reflection_says(camera):
    center, light = np.array([0.1, 0.0, 0.1]), np.array([1.5, 1.2, 1.0])
    scene = scenes.mirror_ball_scene(center, 0.3, light, 0.05)
    view = view_points(camera, sphere_points(center, 0.3), 4)
    image = view.develop(scenes.render(scene, view, 4, seed=0))
    expected, _ = camera.project(reflections(camera.center, light[None], center, 0.3))
    weight = image[..., 1]
    rows, columns = np.mgrid[: weight.shape[0], : weight.shape[1]]
    found = np.array([(weight * columns).sum(), (weight * rows).sum()]) / weight.sum() + 0.5
    # The highlight is about a pixel wide; 64 samples per pixel place its centre to better than a tenth of that.
    np.testing.assert_allclose(found, expected[0], atol=0.1)
    assert image[..., 3].max() == pytest.approx(1)


def test_distances_to_surfaces(camera):
    mesh = scenes.triangle_mesh({"type": "diffuse"}, SQUARE, FACES, UV)
    scene = scenes.lit_scene([mesh], np.ones((1, 3)), np.ones(1), 2)
    directions = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
    distances = scenes.hit_distances(scene, np.array([0.1, 0.2, 2.0]), directions)
    assert distances[0] == pytest.approx(2, rel=1e-6)
    assert np.isinf(distances[1]) or distances[1] > 1e6
