"""The procedural head: a closed mesh with two round eyes, expressions that move what they should, its keypoints."""

import numpy as np
import pandas as pd
import pytest
import trimesh
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from pipeline.config.synthesize_capture import SynthesizeCapture
from pipeline.synthesis.expression import Performance, displaced, performance_at
from pipeline.synthesis.eyeball import CORNEA_OFFSET_M, CORNEA_RADIUS_M, EYE_CENTERS_M, EYE_NAMES, template_eyeball
from pipeline.synthesis.head import build_head
from pipeline.synthesis.head_appearance import IRIS, PUPIL, SCLERA, eye_albedo
from pipeline.synthesis.head_shape import MOUTH_CENTER_M, head_field

SPACING_M = 0.008

APEX_M = CORNEA_OFFSET_M + CORNEA_RADIUS_M
"""From the middle of an eye to its cornea's foremost point."""


@pytest.fixture(scope="module")
def head():
    return build_head("test", SPACING_M, 128, 0.3)


def performing(jaw_deg=0.0, **strengths):
    return Performance(jaw_deg, strengths, Rotation.identity(), np.zeros(3), Rotation.identity())


def test_skin_and_eyes_are_three_closed_surfaces(head):
    mesh = trimesh.Trimesh(head.vertices, head.faces, process=False)
    assert mesh.is_watertight and mesh.is_winding_consistent
    pieces = mesh.split(only_watertight=True)
    assert [piece.euler_number for piece in pieces] == [2, 2, 2]
    assert all(piece.volume > 0 for piece in pieces)
    size = np.ptp(head.vertices, axis=0)
    assert 0.25 < size[1] < 0.32  # with the neck
    # Newton's steps end within a hundredth of an edge even in the creases around what is carved.
    assert np.abs(head_field(head.vertices[: head.skin_count])).max() < 0.01 * SPACING_M


def test_eyes_look_out_of_their_sockets(head):
    assert list(head.eyes) == list(EYE_NAMES) == ["left", "right"]
    for vertices, center in zip(head.eyes.values(), EYE_CENTERS_M, strict=True):
        eye = head.vertices[vertices]
        np.testing.assert_allclose(eye - center, template_eyeball()[0], atol=1e-12)
        # The pupil is in the open; the back of the eye is inside the head.
        assert head_field(eye[:1])[0] > 0
        assert head_field(center[None] - [[0, 0, APEX_M]])[0] < 0


def test_materials_cover_the_skin_and_finer_surfaces_the_eyes(head):
    count = np.zeros(len(head.faces), int)
    for material in head.materials:
        count[material.faces] += 1
    np.testing.assert_array_equal(count, (head.faces < head.skin_count).all(axis=1))
    moment = head.at(0.4, "b")
    coarse = moment.vertices[head.eyes["left"]]
    fine = np.concatenate([s.vertices for s in moment.surfaces if s.name == "left"])
    distance, _ = cKDTree(fine).query(coarse)
    assert distance.max() < 0.001  # half an edge of the fine mesh
    np.testing.assert_allclose(np.linalg.norm(np.concatenate([s.normals for s in moment.surfaces]), axis=1), 1)


def test_mouth_opens_between_the_lips_and_the_skull_stays(head):
    skin = head.vertices[: head.skin_count]
    moved = displaced(skin, performing(jaw_deg=8.0)) - skin
    names = dict(zip(head.keypoint_names, head.keypoint_vertices, strict=True))
    assert moved[names["lip_lower"], 1] < -0.008
    assert moved[names["chin"], 1] < -0.010
    assert np.abs(moved[[names["lip_upper"], names["nose_tip"], names["ear_top_l"]]]).max() == 0
    assert np.abs(moved[skin[:, 1] > MOUTH_CENTER_M[1] + 0.03]).max() == 0
    # Away from the slot between the lips an edge never doubles: no tear that a mesh cannot show.
    edges = trimesh.Trimesh(skin, head.faces[head.materials[0].faces], process=False).edges_unique
    stretch = np.linalg.norm(moved[edges[:, 0]] - moved[edges[:, 1]], axis=1)
    away = np.linalg.norm(skin[edges].mean(axis=1) - MOUTH_CENTER_M, axis=1) > 0.05
    assert stretch[away].max() < 0.75 * SPACING_M


@pytest.mark.parametrize(
    ("name", "keypoint", "toward"),
    [("smile", "mouth_corner", [1, 1, 0]), ("brows", "brow_middle", [0, 1, 0]), ("frown", "brow_inner", [-1, -1, 0])],
)
def test_expressions_move_both_sides_alike(head, name, keypoint, toward):
    names = dict(zip(head.keypoint_names, head.keypoint_vertices, strict=True))
    left, right = (head.vertices[[names[f"{keypoint}_{side}"]]] for side in "lr")
    performance = performing(**{name: 1.0})
    moved = (displaced(left, performance) - left)[0]
    assert moved @ toward > 0.002
    mirrored = left * [-1.0, 1.0, 1.0]
    np.testing.assert_allclose(displaced(mirrored, performance)[0], [-1.0, 1.0, 1.0] * (left[0] + moved), atol=1e-12)
    assert np.linalg.norm(displaced(right, performance) - right) > 0.002


def test_moments_are_rigid_for_the_skull_and_turn_the_eyes(head):
    moment, performance = head.at(0.5, "a"), performance_at(0.5, "a")
    root = Rotation.from_quat(moment.truth["root_rotation"], scalar_first=True)
    skull = np.flatnonzero(head.vertices[: head.skin_count, 1] > 0.09)
    expected = root.apply(head.vertices[skull]) + moment.truth["root_translation"]
    # The widest bump is five deviations away.
    np.testing.assert_allclose(moment.vertices[skull], expected, atol=1e-6)
    assert np.degrees(root.magnitude()) > 15
    pupil = moment.keypoints[head.keypoint_names.index("pupil_l")]
    center = root.apply(EYE_CENTERS_M[0]) + moment.truth["root_translation"]
    gaze = root * performance.gaze
    np.testing.assert_allclose((pupil - center) / APEX_M, gaze.apply([0.0, 0.0, 1.0]), atol=1e-9)
    # What the capture declares is in the head's frame.
    np.testing.assert_allclose(root.apply(moment.gaze["left"]), (pupil - center) / APEX_M, atol=1e-9)
    assert np.degrees(performance.gaze.magnitude()) > 5


def test_motion_is_smooth_in_time(head):
    for segment in "ab":
        vertices = np.stack([head.at(time, segment).vertices for time in np.arange(0, 1.8, 0.05)])
        acceleration = np.diff(vertices, 2, axis=0) / 0.05**2
        # 25 degrees at a radius of 0.15 m once in 1.8 s is 0.8 m/s^2; talking twice that and more.
        assert np.linalg.norm(acceleration, axis=-1).max() < 5.0


def test_template_keypoints_are_the_truths_vertices(head, tmp_path):
    for uvs in (True, False):
        settings = SynthesizeCapture(figure="head", uvs=uvs)
        head.write_template(tmp_path / str(uvs), settings)
        table = pd.read_csv(tmp_path / str(uvs) / "keypoints.csv")
        assert len(table) == 36 and table.keypoint.is_unique and table.vertex.is_unique
        source = head.unwrapped.source if uvs else np.arange(len(head.vertices))
        np.testing.assert_array_equal(source[table.vertex], head.keypoint_vertices)
        eyes = pd.read_csv(tmp_path / str(uvs) / "eyes.csv")
        assert list(eyes.eye.unique()) == ["left", "right"]
        # Every copy of every vertex of the eyes and of nothing else.
        np.testing.assert_array_equal(np.sort(eyes.vertex), np.flatnonzero(source >= head.skin_count))


def test_eye_shows_pupil_iris_and_white():
    albedo = eye_albedo(np.array([[0.0, 0.0, 1.0], [0.3, 0.0, 0.95], [0.8, 0.0, 0.6], [0.0, 0.0, -1.0]]))
    np.testing.assert_allclose(albedo[0], PUPIL, rtol=1e-6)
    assert np.abs(albedo[1] / IRIS - 1).max() < 0.5
    np.testing.assert_allclose(albedo[2:], [SCLERA, SCLERA], rtol=1e-6)
