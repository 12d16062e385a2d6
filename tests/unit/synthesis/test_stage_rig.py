"""The stage: framing, responses, survey, patterns, and board poses that several cameras share."""

import numpy as np
import pytest

from pipeline.config.synthesize_capture import SynthesizeCapture
from pipeline.synthesis.stage_rig import build_stage_rig, light_patterns, survey_lights
from pipeline.synthesis.targets import (
    ball_centers,
    board_poses,
    chart_corners,
    reflections,
    sees_board,
    sphere_points,
)  # fmt: skip

SETTINGS = SynthesizeCapture()


@pytest.fixture(scope="module")
def rig():
    return build_stage_rig("test", SETTINGS)


def test_equal_subjects_have_equal_stages(rig):
    again = build_stage_rig("test", SETTINGS)
    np.testing.assert_array_equal(rig.lights_xyz, again.lights_xyz)
    assert not np.allclose(rig.lights_xyz, build_stage_rig("other", SETTINGS).lights_xyz)


def test_every_camera_frames_a_standing_person(rig):
    for camera in rig.cameras.values():
        pixels, depth = camera.project(np.array([[0.0, 0.9, 0.0], [0.0, -0.9, 0.0], [0.5, 0.0, 0.0], [0.0, 0.0, 0.5]]))
        assert (depth > 1).all()
        assert (pixels > 0).all() and (pixels < [camera.width, camera.height]).all()
        assert pixels[1, 1] - pixels[0, 1] > 0.7 * camera.height


def test_average_color_response_is_the_identity(rig):
    np.testing.assert_allclose(np.mean(list(rig.raw_from_true.values()), axis=0), np.eye(3), atol=1e-12)


def test_survey_error_is_as_configured():
    settings = SETTINGS.model_copy(update={"lights": 400})
    rig = build_stage_rig("test", settings)
    survey = survey_lights("test", rig, 0.015)
    error = survey[["x", "y", "z"]].to_numpy() - rig.lights_xyz
    assert error.std() == pytest.approx(0.015, rel=5 / np.sqrt(2 * error.size))
    assert list(survey.light) == list(rig.light_positions)


def test_patterns_follow_the_settings(rig):
    patterns = light_patterns("test", rig, SETTINGS)
    for frame, rows in patterns.groupby("frame"):
        assert rows.light.is_unique
        if frame % 3 == 0:
            assert len(rows) == SETTINGS.lights
            # Intensities are rounded to 1e-4 each.
            assert rows.intensity.sum() == pytest.approx(SETTINGS.total_intensity, abs=1e-4 * len(rows))
        else:
            assert 4 <= len(rows) <= 8
            assert (rows.intensity / (SETTINGS.total_intensity / 6)).between(0.749, 1.251).all()
            assert rows.intensity.nunique() > 1
    assert sorted(patterns.frame.unique()) == list(range(SETTINGS.frames))


def test_cameras_share_enough_board_views(rig):
    poses = board_poses("test", SETTINGS)
    seen = np.array([[sees_board(camera, corners) for corners in poses] for camera in rig.cameras.values()])
    assert (seen.sum(axis=1) >= 6).all()
    shared_with_next = (seen & np.roll(seen, -1, axis=0)).sum(axis=1)
    assert (shared_with_next >= 2).all()


def test_board_is_seen_from_its_front_only(rig):
    camera = next(iter(rig.cameras.values()))
    corners = chart_corners(camera, np.random.default_rng(0))
    assert sees_board(camera, corners)
    assert not sees_board(camera, corners[[1, 0, 3, 2]])
    pixels, _ = camera.project(corners)
    assert pixels[0, 0] < pixels[1, 0] and pixels[0, 1] < pixels[3, 1]  # upright and not mirrored


def test_reflections_obey_the_law_of_reflection(rig):
    eye, center, radius = np.array([2.4, 0.5, 0.3]), np.array([0.1, 0.2, 0.0]), 0.18
    points = reflections(eye, rig.lights_xyz, center, radius)
    assert len(points) > 20
    normals = (points - center) / radius
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-9)
    incoming = (points - eye) / np.linalg.norm(points - eye, axis=1, keepdims=True)
    outgoing = incoming - 2 * (incoming * normals).sum(axis=1, keepdims=True) * normals
    to_lights = rig.lights_xyz[None] - points[:, None]
    to_lights /= np.linalg.norm(to_lights, axis=2, keepdims=True)
    assert np.abs((to_lights @ outgoing[:, :, None])[..., 0].max(axis=1) - 1).max() < 1e-9


def test_light_behind_the_ball_is_left_out():
    eye, center = np.array([0.0, 0.0, 2.5]), np.zeros(3)
    assert len(reflections(eye, np.array([[0.0, 0.0, -2.0]]), center, 0.18)) == 0
    assert len(reflections(eye, np.array([[0.0, 0.0, 2.0]]), center, 0.18)) == 1


def test_mirror_balls_lie_within_every_image(rig):
    for center in ball_centers("test", SETTINGS):
        for camera in rig.cameras.values():
            pixels, _ = camera.project(sphere_points(center, SETTINGS.ball_radius_m))
            assert (pixels > 0).all() and (pixels < [camera.width, camera.height]).all()
