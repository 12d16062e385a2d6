"""Corrections between refined frames: a constant one arrives everywhere, motion stays, cuts are not crossed."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.geometry.kinematics import Pose
from pipeline.geometry.pose_interpolation import carry_corrections, carry_offsets, neighbours

PIVOT = np.array([0.0, 0.9, 0.1])


def wxyz(rotation: Rotation) -> np.ndarray:
    return rotation.as_quat(scalar_first=True)


def poses(root: Rotation, joints: list[Rotation], translation: np.ndarray) -> Pose:
    return Pose(wxyz(root), translation, np.stack([wxyz(joint) for joint in joints], 1))


def test_neighbours_at_ends_and_at_cuts() -> None:
    before, after, share = neighbours(np.array([1, 4]), 6)
    assert before.tolist() == [0, 0, 0, 0, 1, 1]
    assert after.tolist() == [0, 0, 1, 1, 1, 1]
    assert np.allclose(share[:5], [0, 0, 1 / 3, 2 / 3, 0])
    takes = np.array([0, 0, 0, 1, 1, 1])
    before, after, _ = neighbours(np.array([1, 4]), 6, takes)
    assert before.tolist() == after.tolist() == [0, 0, 0, 1, 1, 1]


def test_a_constant_correction_arrives_in_every_frame() -> None:
    random = np.random.default_rng(0)
    root = Rotation.from_rotvec(random.normal(size=(7, 3)))
    joints = [Rotation.from_rotvec(random.normal(size=(7, 3))) for _ in range(3)]
    translation = random.normal(size=(7, 3))
    turns = [Rotation.from_rotvec(v) for v in ([0.3, 0, 0], [0, -2.0, 0.1], [0, 0, 0])]
    root_turn, shift = Rotation.from_rotvec([0.0, 0.2, -0.1]), np.array([0.01, 0.02, -0.03])
    true_root = root * root_turn
    # The pivot moves by `shift`, whatever the root's turn about it.
    true_translation = root.apply(PIVOT) + translation + shift - true_root.apply(PIVOT)
    truth = poses(true_root, [j * t for j, t in zip(joints, turns, strict=True)], true_translation)
    known = np.array([0, 3, 6])
    carried = carry_corrections(poses(root, joints, translation), truth.at(known), known, PIVOT)
    for name in ("root_rotation", "joint_rotations"):
        cosine = np.abs((getattr(carried, name) * getattr(truth, name)).sum(-1))
        assert np.abs(cosine - 1).max() < 1e-12
    assert np.abs(carried.root_translation - truth.root_translation).max() < 1e-12


def test_offsets_run_along_lines() -> None:
    offsets = np.random.default_rng(1).normal(size=(2, 5, 3))
    carried = carry_offsets(offsets, np.array([0, 4]), 5)
    assert np.allclose(carried[1], 0.75 * offsets[0] + 0.25 * offsets[1])
    assert np.array_equal(carried[4], offsets[1])
