"""An unrigged template in motion: root transform, smooth offsets and turning rigid pieces.

A point p that deforms is at ``R (p + B C) + t``, with rows B of the deformation basis and coefficients C; a point of a
rigid piece is at ``R (c + exp(g) (p - c)) + t``, c being the piece's centre. Unknowns per frame are, in this order, the
step of the pivot and of the root rotation as in `pipeline.geometry.kinematics`, the rotation vectors g, and C mode by
mode.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from pipeline.geometry.rotations import (
    left_jacobian,
    matrix_from_quaternion,
    matrix_from_rotation_vector,
    multiply_quaternions,
    quaternion_from_rotation_vector,
    skew,
)
from pipeline.geometry.skin import Template
from pipeline.geometry.surface_points import SurfacePoints
from pipeline.tracking.deformation_basis import DeformationBasis
from pipeline.tracking.pose_equations import PointQuadratic


@dataclass(frozen=True)
class SurfaceMotion:
    """The unknowns of consecutive frames; `turns` are rotation vectors in the template's frame."""

    root_rotation: Float64[np.ndarray, "frames 4"]
    root_translation: Float64[np.ndarray, "frames 3"]
    turns: Float64[np.ndarray, "frames parts 3"]
    coefficients: Float64[np.ndarray, "frames modes 3"]

    def __len__(self) -> int:
        return len(self.root_rotation)

    @property
    def shape(self) -> Float64[np.ndarray, "frames shape_unknowns"]:
        """All but the root: turns, then coefficients."""
        count = len(self)
        return np.concatenate([self.turns.reshape(count, -1), self.coefficients.reshape(count, -1)], 1)


@dataclass(frozen=True)
class TemplatePoints:
    """Points on a template that a `SurfaceMotion` moves.

    Attributes:
        rest: where they rest, metres.
        modes: their rows of the deformation basis.
        part: their rigid piece, -1 for points that deform.
        center: middle of the rigid piece, metres.
    """

    rest: Float64[np.ndarray, "points 3"]
    modes: Float64[np.ndarray, "points modes"]
    part: Int64[np.ndarray, " points"]
    center: Float64[np.ndarray, "points 3"]


@dataclass(frozen=True)
class SurfaceModel:
    """A template and the ways it may deform.

    Attributes:
        pivot: point that the root turns about, template's frame, metres.
    """

    template: Template
    basis: DeformationBasis
    pivot: Float64[np.ndarray, " 3"]

    @property
    def parts(self) -> int:
        """Number of rigid pieces."""
        return len(self.basis.centers)

    def points(self, points: SurfacePoints) -> TemplatePoints:
        """Points that are fixed to faces."""
        part = self.basis.part[points.corners[:, 0]]
        modes = np.einsum("pc,pck->pk", points.barycentric, self.basis.modes[points.corners])
        return TemplatePoints(points.carried(self.template.vertices_rest), modes, part, self._centers(part))

    def vertices(self) -> TemplatePoints:
        """All vertices of the template."""
        part = self.basis.part
        return TemplatePoints(self.template.vertices_rest, self.basis.modes, part, self._centers(part))

    def _centers(self, part: np.ndarray) -> np.ndarray:
        return np.concatenate([self.basis.centers, np.zeros((1, 3))])[part]

    def rest(self, root_rotation: np.ndarray, root_translation: np.ndarray) -> SurfaceMotion:
        """The rest shape, moved rigidly."""
        count = len(root_rotation)
        modes = self.basis.modes.shape[1]
        return SurfaceMotion(
            root_rotation, root_translation, np.zeros((count, self.parts, 3)), np.zeros((count, modes, 3))
        )

    def moved(self, motion: SurfaceMotion, step: Float64[np.ndarray, "frames unknowns"]) -> SurfaceMotion:
        """The motion after a step of all unknowns."""
        rotation = multiply_quaternions(motion.root_rotation, quaternion_from_rotation_vector(step[:, 3:6]))
        rotation /= np.linalg.norm(rotation, axis=1, keepdims=True)
        before, after = matrix_from_quaternion(motion.root_rotation), matrix_from_quaternion(rotation)
        translation = motion.root_translation + step[:, :3] + (before - after) @ self.pivot
        turns, coefficients = np.split(step[:, 6:], [3 * self.parts], axis=1)
        return SurfaceMotion(
            rotation, translation, motion.turns + turns.reshape(motion.turns.shape),
            motion.coefficients + coefficients.reshape(motion.coefficients.shape),
        )  # fmt: skip


def in_template(points: TemplatePoints, motion: SurfaceMotion) -> Float64[np.ndarray, "frames points 3"]:
    """Positions in the template's frame, metres."""
    result = points.rest + np.einsum("pk,fka->fpa", points.modes, motion.coefficients, optimize=True)
    rigid = np.flatnonzero(points.part >= 0)
    if len(rigid):
        arm = points.rest[rigid] - points.center[rigid]
        turned = np.einsum("fpab,pb->fpa", matrix_from_rotation_vector(motion.turns)[:, points.part[rigid]], arm)
        result[:, rigid] = points.center[rigid] + turned
    return result


def positions(points: TemplatePoints, motion: SurfaceMotion) -> Float64[np.ndarray, "frames points 3"]:
    """Positions in the world, metres."""
    root = matrix_from_quaternion(motion.root_rotation).transpose(0, 2, 1)
    return in_template(points, motion) @ root + motion.root_translation[:, None]


def normal_equations(
    model: SurfaceModel, points: TemplatePoints, motion: SurfaceMotion, quadratic: PointQuadratic
) -> tuple[Float64[np.ndarray, "frames unknowns unknowns"], Float64[np.ndarray, "frames unknowns"]]:
    """Gauss-Newton matrix and gradient by the unknowns, from those by world positions."""
    frames, few = len(motion), 6 + 3 * model.parts
    count = few + 3 * points.modes.shape[1]
    normal, gradient = np.zeros((frames, count, count)), np.zeros((frames, count))
    root = matrix_from_quaternion(motion.root_rotation)
    local = in_template(points, motion)
    for f in range(frames):
        seen = np.flatnonzero(quadratic.normal[f].any((1, 2)))
        # In the template's frame, where a mode moves x, y and z alike.
        matrix = root[f].T @ quadratic.normal[f, seen] @ root[f]
        slope = quadratic.gradient[f, seen] @ root[f]
        rigid = _rigid_derivatives(model, points, motion, f, seen, local[f, seen], root[f])
        modes = points.modes[seen]
        weighted = matrix @ rigid
        normal[f, :few, :few] = np.tensordot(rigid, weighted, ((0, 1), (0, 1)))
        gradient[f, :few] = np.tensordot(slope, rigid, 2)
        gradient[f, few:] = (modes.T @ slope).ravel()
        for a in range(3):
            normal[f, few + a :: 3, :few] = modes.T @ weighted[:, a]
            for b in range(a + 1):
                block = modes.T @ (matrix[:, a, b, None] * modes)
                normal[f, few + a :: 3, few + b :: 3] = block
                normal[f, few + b :: 3, few + a :: 3] = block
        normal[f, :few, few:] = normal[f, few:, :few].T
    return normal, gradient


def _rigid_derivatives(
    model: SurfaceModel, points: TemplatePoints, motion: SurfaceMotion, f: int, seen: np.ndarray, local: np.ndarray,
    root: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Derivatives [points, 3, 6 + 3 parts] of positions in the template's frame."""
    result = np.zeros((len(seen), 3, 6 + 3 * model.parts))
    result[:, :, :3] = root.T
    result[:, :, 3:6] = -skew(local - model.pivot)
    jacobian = left_jacobian(motion.turns[f])
    for part in range(model.parts):
        own = np.flatnonzero(points.part[seen] == part)
        at = slice(6 + 3 * part, 9 + 3 * part)
        result[own, :, at] = -skew(local[own] - points.center[seen[own]]) @ jacobian[part]
    return result
