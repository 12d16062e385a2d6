"""Poses between frames whose poses are known: interpolated on the rotation manifold."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int64

from pipeline.geometry.kinematics import Pose
from pipeline.geometry.rotations import conjugate_quaternion, matrix_from_quaternion, multiply_quaternions, slerp


def neighbours(
    known: Int64[np.ndarray, " known"], frames: int, takes: Int64[np.ndarray, " frames"] | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Known frames before and after every frame, and how far between these it is, 0..1.

    From the frames in `known`.

    Before the first and after the last, both are the nearest. Where one of them belongs to another take (`takes`) than
    the frame, the other stands for both.
    """
    wanted = np.arange(frames)
    after = np.minimum(np.searchsorted(known, wanted), len(known) - 1)
    before = np.where(known[after] > wanted, np.maximum(after - 1, 0), after)
    if takes is not None:
        same_before, same_after = takes[known[before]] == takes, takes[known[after]] == takes
        before = np.where(same_after & ~same_before, after, before)
        after = np.where(same_before & ~same_after, before, after)
    share = np.clip((wanted - known[before]) / np.maximum(known[after] - known[before], 1), 0.0, 1.0)
    return before, after, share


def fill_between(
    pose: Pose, known: Int64[np.ndarray, " known"], frames: int, pivot: Float64[np.ndarray, " 3"],
    takes: Int64[np.ndarray, " frames"] | None = None,
) -> Pose:  # fmt: skip
    """Interpolate poses of all `frames` from those of the `known` ones.

    Rotations by slerp and the pivot along a line in between, the nearest pose before the first and after the last.
    """
    before, after, share = neighbours(known, frames, takes)
    rotation = slerp(pose.root_rotation[before], pose.root_rotation[after], share)
    pivots = _pivots(pose, pivot)
    between = pivots[before] * (1 - share[:, None]) + pivots[after] * share[:, None]
    joints = slerp(pose.joint_rotations[before], pose.joint_rotations[after], share[:, None])
    return Pose(rotation, between - matrix_from_quaternion(rotation) @ pivot, joints)


def carry_corrections(
    pose: Pose, refined: Pose, known: Int64[np.ndarray, " known"], pivot: Float64[np.ndarray, " 3"],
    takes: Int64[np.ndarray, " frames"] | None = None,
) -> Pose:  # fmt: skip
    """All poses, corrected as `refined` corrects the `known` ones.

    What refinement changed is a rotation of every joint and of the root in their own frames, and a shift of the pivot.
    These are interpolated between the known frames, so that the motion in between stays that of `pose`.
    """
    old = pose.at(known)
    turns = multiply_quaternions(conjugate_quaternion(old.joint_rotations), refined.joint_rotations)
    turn = multiply_quaternions(conjugate_quaternion(old.root_rotation), refined.root_rotation)
    shift = _pivots(refined, pivot) - _pivots(old, pivot)
    before, after, share = neighbours(known, len(pose), takes)
    rotation = multiply_quaternions(pose.root_rotation, slerp(turn[before], turn[after], share))
    moved = _pivots(pose, pivot) + shift[before] * (1 - share[:, None]) + shift[after] * share[:, None]
    joints = multiply_quaternions(pose.joint_rotations, slerp(turns[before], turns[after], share[:, None]))
    return Pose(rotation, moved - matrix_from_quaternion(rotation) @ pivot, joints)


def carry_offsets(
    offsets: Float64[np.ndarray, "known vertices 3"], known: Int64[np.ndarray, " known"], frames: int,
    takes: Int64[np.ndarray, " frames"] | None = None,
) -> Float64[np.ndarray, "frames vertices 3"]:  # fmt: skip
    """Offsets before skinning of all `frames`, along a line between the known ones'."""
    before, after, share = neighbours(known, frames, takes)
    return offsets[before] * (1 - share[:, None, None]) + offsets[after] * share[:, None, None]


def _pivots(pose: Pose, pivot: np.ndarray) -> Float64[np.ndarray, "frames 3"]:
    return matrix_from_quaternion(pose.root_rotation) @ pivot + pose.root_translation
