"""Posing against closed forms: rest, rigid motion, a single bent joint."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.synthesis.figure import build_figure
from pipeline.synthesis.motion import pose_at
from pipeline.synthesis.skinning import INFLUENCES, joint_transforms, pose_vertices
from pipeline.synthesis.subject import vertex_normals

IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])

ROUNDING_M = 1e-12
"""A dozen float64 transforms of metre-sized numbers."""


@pytest.fixture(scope="module")
def figure():
    return build_figure("test", 0.045, 128, 0.25)


def still(figure):
    return np.tile(IDENTITY, (len(figure.skeleton.names), 1))


def test_rest_pose_equals_template(figure):
    vertices, joints = figure.posed(still(figure), np.zeros(3))
    np.testing.assert_allclose(vertices, figure.vertices, atol=ROUNDING_M)
    np.testing.assert_allclose(joints, figure.skeleton.positions, atol=ROUNDING_M)


def test_root_moves_everything_rigidly(figure):
    turn = Rotation.from_euler("zyx", [0.3, -0.8, 0.2])
    rotations = still(figure)
    rotations[0] = turn.as_quat(scalar_first=True)
    shift = np.array([0.2, -0.9, 0.1])
    vertices, _ = figure.posed(rotations, shift)
    root = figure.skeleton.positions[0]
    np.testing.assert_allclose(vertices, turn.apply(figure.vertices - root) + root + shift, atol=ROUNDING_M)


def test_bent_elbow_moves_the_hand_about_the_elbow_and_nothing_else(figure):
    skeleton, turn = figure.skeleton, Rotation.from_rotvec([0.0, -1.2, 0.0])
    rotations = still(figure)
    elbow = skeleton.index("forearm_l")
    rotations[elbow] = turn.as_quat(scalar_first=True)
    vertices, joints = figure.posed(rotations, np.zeros(3))
    pivot = skeleton.positions[elbow]
    hand = skeleton.index("hand_l")
    np.testing.assert_allclose(joints[hand], turn.apply(skeleton.positions[hand] - pivot) + pivot, atol=ROUNDING_M)
    moved = figure.weights[:, [elbow, hand, skeleton.index("fingertip_l")]].sum(axis=1)
    assert (moved == 1).sum() > 20
    rigid = turn.apply(figure.vertices - pivot) + pivot
    np.testing.assert_allclose(vertices[moved == 1], rigid[moved == 1], atol=ROUNDING_M)
    np.testing.assert_allclose(vertices[moved == 0], figure.vertices[moved == 0], atol=ROUNDING_M)


def test_weights_are_a_smooth_partition(figure):
    weights = figure.weights
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-12)
    assert (weights >= 0).all()
    assert ((weights > 0).sum(axis=1) <= INFLUENCES).all()
    edges = figure.faces[:, [0, 1]]
    # A step over a whole joint within one edge would crease the skin.
    assert np.abs(weights[edges[:, 0]] - weights[edges[:, 1]]).max() < 0.6
    left = [j for j, name in enumerate(figure.skeleton.names) if name.endswith("_l")]
    # Eight rounds of diffusion from the crotch at 0.85 m reach eight edges of 0.045 m down.
    right_leg = (figure.vertices[:, 0] < 0) & (figure.vertices[:, 1] < 0.85 - 8 * 0.045)
    assert weights[right_leg][:, left].max() == 0


def test_blended_vertex_is_the_weighted_mean(figure):
    random = np.random.default_rng(0)
    world = joint_transforms(
        figure.skeleton, Rotation.random(len(figure.skeleton.names), rng=random).as_quat(scalar_first=True), np.ones(3)
    )
    vertex, weights = random.normal(size=3), np.zeros(len(figure.skeleton.names))
    weights[[2, 5]] = 0.25, 0.75
    expected = np.zeros(3)
    for joint in (2, 5):
        inverse_bind = np.eye(4)
        inverse_bind[:3, 3] = -figure.skeleton.positions[joint]
        expected += weights[joint] * (world[joint] @ inverse_bind @ [*vertex, 1])[:3]
    posed = pose_vertices(vertex[None], weights[None], figure.skeleton, world)
    np.testing.assert_allclose(posed[0], expected, atol=ROUNDING_M)


@pytest.mark.parametrize("segment", ["a", "b"])
def test_motion_is_smooth_and_brings_an_arm_before_the_torso(figure, segment):
    times = np.arange(0, 1.6, 0.02)
    poses = [pose_at(figure.skeleton, t, segment, -0.9) for t in times]
    joints = np.stack([figure.posed(p.rotations, p.root_translation)[1] for p in poses])
    assert np.linalg.norm(np.diff(joints, axis=0), axis=2).max() < 0.02 * 6  # below 6 m/s
    chest = joints[:, figure.skeleton.index("spine")]
    hands = joints[:, [figure.skeleton.index(f"hand_{side}") for side in "lr"]]
    in_front = (hands[..., 2] > chest[:, None, 2] + 0.15) & (np.abs(hands[..., 0] - chest[:, None, 0]) < 0.2)
    assert in_front.any(axis=1).mean() > 0.3


def test_normals_of_a_cube_corner():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = np.array([[0, 2, 1], [0, 3, 2], [0, 1, 3]])
    np.testing.assert_allclose(vertex_normals(vertices, faces)[0], -np.ones(3) / np.sqrt(3))
