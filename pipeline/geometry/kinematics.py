"""Points carried by a posed template, and their derivatives by its pose.

By every rotation and by the root translation.

A tracked point k (a keypoint, or a vertex) is ``sum_j G_j B_kj`` in template space: for a joint, B is (0, 0, 0, 1) at
that joint; for a vertex, its skinning weight times its bind position. Rotations are perturbed on the right,
``R_j exp(d)``: with M_j = (everything above and including R_j) and y = M_j^-1 (the part of the point that hangs
below j), the derivative is ``-M_j [y]x``. Exact for any affine chain, scaled joints included.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64, Int64

from pipeline.geometry.kinematics_kernels import add_point_derivatives
from pipeline.geometry.rotations import (
    matrix_from_quaternion,
    multiply_quaternions,
    quaternion_from_rotation_vector,
    skew,
)
from pipeline.geometry.skin import Template, joint_transforms, joints_in_order
from pipeline.geometry.surface_points import SurfacePoints


@dataclass(frozen=True)
class Pose:
    """Poses of consecutive frames; see `pipeline.geometry.skin.posed` for what they mean."""

    root_rotation: Float64[np.ndarray, "frames 4"]
    root_translation: Float64[np.ndarray, "frames 3"]
    joint_rotations: Float64[np.ndarray, "frames joints 4"]

    def __len__(self) -> int:
        return len(self.root_rotation)

    def at(self, frames: np.ndarray | slice) -> Pose:
        """The poses of some of the frames."""
        return Pose(self.root_rotation[frames], self.root_translation[frames], self.joint_rotations[frames])

    def replaced(self, frames: Int64[np.ndarray, " some"], poses: Pose) -> Pose:
        """These poses with some of the frames' exchanged."""
        new = Pose(self.root_rotation.copy(), self.root_translation.copy(), self.joint_rotations.copy())
        new.root_rotation[frames], new.root_translation[frames] = poses.root_rotation, poses.root_translation
        new.joint_rotations[frames] = poses.joint_rotations
        return new


@dataclass(frozen=True)
class TrackedPoints:
    """Points on a template in the form the module docstring gives.

    Attributes:
        parts: B, zero where a joint does not carry a point. An unrigged template has one fixed pseudo-joint.
        carried: whether joint k hangs below joint j (or is it), [j, k], as 0 and 1.
        free: joints that may rotate: all but the first root, which the root transform moves.
        pivot: template-space point, metres, that the root rotation turns about while solving.
    """

    template: Template
    parts: Float64[np.ndarray, "points carriers 4"]
    carried: Float64[np.ndarray, "carriers carriers"]
    free: Int64[np.ndarray, " free"]
    pivot: Float64[np.ndarray, " 3"]

    @property
    def unknowns(self) -> int:
        """Numbers per frame: root translation, root rotation, then three per free joint."""
        return 6 + 3 * len(self.free)

    def with_surface(self, surface: SurfacePoints) -> TrackedPoints:
        """These points and then some on the surface, with the same pivot and unknowns."""
        corners, which = np.unique(surface.corners, return_inverse=True)
        parts = tracked_points(self.template, np.full(len(corners), -1, np.int64), corners).parts
        more = np.einsum("pcja,pc->pja", parts[which.reshape(surface.corners.shape)], surface.barycentric)
        return replace(self, parts=np.concatenate([self.parts, more]))

    def rest_pose(self, frames: int) -> Pose:
        """The rest pose, untransformed, for a number of frames."""
        tile = (frames, *(1,) * self.template.rest_rotations.ndim)
        identity = np.tile([1.0, 0.0, 0.0, 0.0], (frames, 1))
        return Pose(identity, np.zeros((frames, 3)), np.tile(self.template.rest_rotations, tile))


def tracked_points(
    template: Template, joints: Int64[np.ndarray, " points"], vertices: Int64[np.ndarray, " points"]
) -> TrackedPoints:
    """Points that sit on a joint or on a vertex.

    On a joint (index into the skin's joints) or, where that is -1, on a vertex.
    """
    carriers = max(len(template.joint_nodes), 1)
    parts = np.zeros((len(joints), carriers, 4))
    on_joint = joints >= 0
    parts[on_joint, joints[on_joint], 3] = 1.0
    bind = template.vertices_bind[vertices[~on_joint]]
    homogeneous = np.concatenate([bind, np.ones((len(bind), 1))], 1)
    if template.rigged:
        moved = np.einsum("jab,nb->nja", template.inverse_bind, homogeneous)
        parts[~on_joint] = template.weights[vertices[~on_joint]][..., None] * moved
    else:
        parts[~on_joint, 0] = homogeneous
    carried = np.eye(carriers)
    for joint in reversed(joints_in_order(template.parents)):
        if template.parents[joint] >= 0:
            carried[template.parents[joint]] += carried[joint]
    free = np.delete(np.arange(len(template.joint_nodes)), template.root_joints[:1])
    points = TrackedPoints(template, parts, carried, free, np.zeros(3))
    return replace(points, pivot=point_positions(points, points.rest_pose(1))[0].mean(0))


def _carrier_transforms(points: TrackedPoints, pose: Pose) -> Float64[np.ndarray, "frames carriers 4 4"]:
    if points.template.rigged:
        return joint_transforms(points.template, pose.joint_rotations)
    return np.broadcast_to(np.eye(4), (len(pose), 1, 4, 4))


def point_positions(points: TrackedPoints, pose: Pose) -> Float64[np.ndarray, "frames points 3"]:
    """World positions of the tracked points, metres."""
    transforms = _carrier_transforms(points, pose)
    in_template = np.einsum("fjab,kjb->fka", transforms[:, :, :3], points.parts, optimize=True)
    in_template *= points.template.scale_to_m
    return in_template @ matrix_from_quaternion(pose.root_rotation).transpose(0, 2, 1) + pose.root_translation[:, None]


def points_with_derivatives(
    points: TrackedPoints, pose: Pose
) -> tuple[Float64[np.ndarray, "frames points 3"], Float64[np.ndarray, "frames points 3 unknowns"]]:
    """World positions and their derivatives by the unknowns of `moved`.

    In metres per metre or radian. The slow twin of `derivatives_of`.
    """
    template, scale = points.template, points.template.scale_to_m
    transforms = _carrier_transforms(points, pose)
    contributions = np.einsum("fjab,kjb->fkja", transforms, points.parts, optimize=True)
    in_template = scale * contributions.sum(2)[..., :3]
    root = matrix_from_quaternion(pose.root_rotation)
    positions = in_template @ root.transpose(0, 2, 1) + pose.root_translation[:, None]
    derivatives = np.zeros((*positions.shape, points.unknowns))
    derivatives[..., :3] = np.eye(3)
    derivatives[..., 3:6] = -root[:, None] @ skew(in_template - points.pivot)
    if len(points.free):
        hanging = np.einsum("jn,fkna->fkja", points.carried[points.free], contributions, optimize=True)
        # Everything above and including R_j; `after` comes below it.
        above = (transforms @ np.linalg.inv(template.after))[:, points.free]
        below = np.einsum("fjab,fkjb->fkja", np.linalg.inv(above), hanging, optimize=True)[..., :3]
        turning = -scale * (root[:, None] @ above[..., :3, :3])
        by_joint = turning[:, None] @ skew(below)
        derivatives[..., 6:] = by_joint.transpose(0, 1, 3, 2, 4).reshape(*positions.shape, -1)
    return positions, derivatives


def derivatives_of(
    points: TrackedPoints, pose: Pose, wanted: Bool[np.ndarray, "frames points"]
) -> Iterator[tuple[Int64[np.ndarray, " some"], Float64[np.ndarray, "some 3 unknowns"]]]:
    """Derivatives of the `wanted` points, frame by frame: which points, and their derivatives.

    They are those of `points_with_derivatives`. One frame at a time, they stay in the processor's cache.
    """
    template, scale = points.template, points.template.scale_to_m
    transforms = np.ascontiguousarray(_carrier_transforms(points, pose))
    root = matrix_from_quaternion(pose.root_rotation)
    above = np.zeros((len(pose), 0, 4, 4))
    if len(points.free):
        above = (transforms @ np.linalg.inv(template.after))[:, points.free]
    inverse = np.ascontiguousarray(np.linalg.inv(above)[:, :, :3])
    turning = -scale * (root[:, None] @ above[..., :3, :3])
    carried = points.carried[points.free]
    for frame in range(len(pose)):
        some = np.flatnonzero(wanted[frame])
        derivatives = np.zeros((len(some), 3, points.unknowns))
        add_point_derivatives(
            some, points.parts, carried, transforms[frame], inverse[frame], turning[frame], root[frame], points.pivot,
            scale, derivatives,
        )  # fmt: skip
        yield some, derivatives


def moved(points: TrackedPoints, pose: Pose, step: Float64[np.ndarray, "frames unknowns"]) -> Pose:
    """Pose after a step.

    Root translation, root rotation about the pivot, then each free joint's rotation.
    """
    rotation = multiply_quaternions(pose.root_rotation, quaternion_from_rotation_vector(step[:, 3:6]))
    pivot_before = matrix_from_quaternion(pose.root_rotation) @ points.pivot
    translation = pose.root_translation + step[:, :3] + pivot_before - matrix_from_quaternion(rotation) @ points.pivot
    joints = pose.joint_rotations.copy()
    turns = quaternion_from_rotation_vector(step[:, 6:].reshape(len(pose), -1, 3))
    joints[:, points.free] = multiply_quaternions(joints[:, points.free], turns)
    return Pose(rotation / np.linalg.norm(rotation, axis=1, keepdims=True), translation,
                joints / np.linalg.norm(joints, axis=2, keepdims=True))  # fmt: skip
