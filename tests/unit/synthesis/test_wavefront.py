"""The vectorized renderer against closed forms and the scalar one, and when it is chosen."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.config.synthesize_capture import SynthesizeCapture
from pipeline.geometry.cameras import Camera
from pipeline.synthesis import mitsuba_scenes as scenes
from pipeline.synthesis import renderer_choice
from pipeline.synthesis.lens import view_points
from pipeline.synthesis.stage_rig import look_at

pytest.importorskip("mitsuba")

CENTER = np.array([0.5, 0.4, 2.2])
SQUARE = np.array([[-0.5, 0.5, 0.0], [0.5, 0.5, 0.0], [0.5, -0.5, 0.0], [-0.5, -0.5, 0.0]])
FACES = np.array([[0, 2, 1], [0, 3, 2]])
UV = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
LIGHTS = np.array([[0.3, 0.6, 1.1], [-0.8, 0.1, 0.9], [0.1, -0.9, 0.5], [0.4, 0.2, 1.5], [0.0, 0.7, 0.7]])
INTENSITIES = np.array([2.0, 3.0, 0.5, 1.0, 4.0])


@pytest.fixture(scope="session")
def llvm():
    """The version of a fit LLVM library; a child process looks for it, as a wrong one ends the process."""
    version = renderer_choice.tried_version(dict(os.environ))
    if not version:
        pytest.skip("no LLVM library")
    return version


@pytest.fixture(scope="module")
def view():
    R = look_at(CENTER, np.zeros(3), roll=0.1)
    K = np.array([[130.0, 0, 47], [0, 131, 51], [0, 0, 1]])
    camera = Camera(R, -R @ CENTER, K, np.array([-0.08, 0.02, 0.001, 0.002, 0.0]), 96, 100)
    return view_points(camera, SQUARE, 2)


def square():
    return scenes.triangle_mesh({"type": "diffuse", "reflectance": 0.4}, SQUARE, FACES, UV)


def wavefront_image(view, samples, seed=3, traced=None):
    from pipeline.synthesis import camera_rays, wavefront

    with scenes.llvm_variant():
        traced = camera_rays.traced_pixels(view, SQUARE, FACES) if traced is None else traced
        entry = camera_rays.WavefrontView(view, traced, seed)
        scene = scenes.mesh_scene([square()])
        return wavefront.render_views(scene, [entry, entry], LIGHTS, INTENSITIES, samples, 4)


def test_lambertian_plane_reflects_all_lights(llvm, view):
    image = view.develop(wavefront_image(view, 4)[1])
    pixels = np.array([[47.5, 50.5], [40.5, 61.5], [60.5, 40.5], [35.5, 45.5]])
    directions = view.camera.ray_directions(pixels)
    points = view.camera.center - view.camera.center[2] / directions[:, 2:] * directions
    to_lights = LIGHTS - points[:, None]
    distances = np.linalg.norm(to_lights, axis=2)
    expected = (INTENSITIES * 0.4 / np.pi * to_lights[..., 2] / distances**3).sum(axis=1)
    found = image[(pixels[:, 1] - 0.5).astype(int), (pixels[:, 0] - 0.5).astype(int)]
    # Irradiance varies by 1 % over a pixel, which the average over it blurs.
    np.testing.assert_allclose(found[:, 1], expected, rtol=0.01)
    np.testing.assert_allclose(found[:, 3], 1)


def test_edges_are_where_the_scalar_renderer_sees_them(llvm, view):
    found = wavefront_image(view, 16)[0]
    scalar = scenes.render(scenes.lit_scene([square()], LIGHTS, INTENSITIES, 2), view, 256, seed=1)
    # 64 stratified places in a pixel know an edge's share to 2 %; the radiance is at most 1.5.
    np.testing.assert_allclose(found[..., 3], scalar[..., 3], atol=0.06)
    assert np.abs(found[..., 3] - scalar[..., 3]).mean() < 0.002
    assert np.sqrt(((found - scalar)[..., :3] ** 2).mean()) < 0.02


def test_same_seed_same_picture_and_another_differs(llvm, view):
    first, second = wavefront_image(view, 2, seed=5)
    np.testing.assert_array_equal(first, second)
    np.testing.assert_array_equal(first, wavefront_image(view, 2, seed=5)[0])
    assert (first != wavefront_image(view, 2, seed=6)[0]).any()


def test_launches_do_not_change_the_picture(llvm, view, monkeypatch):
    from pipeline.synthesis import camera_rays

    whole = wavefront_image(view, 2)
    monkeypatch.setattr(camera_rays, "LANES", 5000)
    np.testing.assert_array_equal(wavefront_image(view, 2), whole)


def test_untraced_pixels_are_empty(llvm, view):
    width, height = view.crop[2:]
    everything = wavefront_image(view, 2, traced=np.ones((height, width), bool))
    np.testing.assert_array_equal(wavefront_image(view, 2), everything)
    nothing = wavefront_image(view, 2, traced=np.zeros((height, width), bool))
    assert not np.any(nothing)


def test_net_has_a_point_in_every_elementary_interval(llvm):
    from pipeline.synthesis.camera_rays import net_points

    points = net_points(64) / 2**32
    for columns in (1, 2, 4, 8, 16, 32, 64):
        cells = np.floor(points * [columns, 64 // columns]).astype(int)
        assert len({tuple(cell) for cell in cells}) == 64


def test_a_trial_agrees_and_a_missing_library_does_not(llvm):
    code = "from pipeline.synthesis.renderer_choice import print_trial; print_trial()"
    printed = json.loads(subprocess.run([sys.executable, "-c", code], capture_output=True, check=True).stdout)
    assert printed["ratio"] == pytest.approx(1, abs=renderer_choice.AGREEMENT / 2)
    assert printed["version"] == llvm
    assert renderer_choice.tried_version({**os.environ, renderer_choice.LIBRARY: "/nonexistent.so"}) in ("", llvm)


@pytest.fixture
def trials(monkeypatch):
    """Environments that were tried; none has a fit library."""
    tried = []
    monkeypatch.setattr(renderer_choice, "tried_version", lambda environment: tried.append(environment) or "")
    return tried


def test_small_captures_and_translucent_ones_try_nothing(trials):
    small = SynthesizeCapture(frames=2, frames_b=1, cameras=2)
    for settings in (small, SynthesizeCapture(material="translucent"), SynthesizeCapture(renderer="scalar")):
        assert renderer_choice.choose_renderer(settings) == ("scalar", "")
    assert not trials


def test_large_captures_fall_back_where_nothing_is_fit(trials):
    assert renderer_choice.choose_renderer(SynthesizeCapture()) == ("scalar", "")
    assert trials


def test_llvm_that_is_missed_is_named_if_asked_for(trials):
    with pytest.raises(InputError, match="LLVM"):
        renderer_choice.choose_renderer(SynthesizeCapture(renderer="llvm"))
