"""Template meshes and linear-blend skinning.

Rest pose, joints, weights, and the posed vertices of every frame.

A vertex v of a rigged template is, in template space (metres, before the root transform),
``scale_to_m * sum_j w_vj G_j B_j v``: B_j the inverse bind matrices, G_j the joints' global transforms. Each joint is
``G_j = G_parent @ before_j @ R_j @ after_j``: `before` is its translation and any non-joint nodes above it, R_j its
local rotation, `after` its scale. Source: glTF 2.0 specification, section 3.7.3 (skins).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from pipeline.geometry.rotations import matrix_from_quaternion


@dataclass(frozen=True)
class Skeleton:
    """Joints of one skin in the skin's order; none of an unrigged mesh.

    Attributes:
        joint_nodes: glTF node index per joint.
        parents: index of the parent *joint*, or -1.
        before, after: the fixed 4x4 parts of each joint's local transform (module docstring), glTF units.
        rest_rotations: local rotations in the rest pose, quaternions wxyz.
        inverse_bind: inverse bind matrices.
    """

    joint_nodes: Int64[np.ndarray, " joints"]
    parents: Int64[np.ndarray, " joints"]
    before: Float64[np.ndarray, "joints 4 4"]
    after: Float64[np.ndarray, "joints 4 4"]
    rest_rotations: Float64[np.ndarray, "joints 4"]
    inverse_bind: Float64[np.ndarray, "joints 4 4"]


@dataclass(frozen=True)
class Template(Skeleton):
    """A template mesh in the glTF file's vertex order (primitives concatenated), rigged or not.

    Attributes:
        vertices_rest: the skinned rest pose (unrigged: the mesh under its node's transform), metres.
        faces: vertex indices per triangle.
        uv: texture coordinates per vertex (glTF: v points down), or None if a primitive has none.
        weights: skinning weights, dense; rows sum to 1.
        vertices_bind: vertices before skinning, glTF units.
        scale_to_m: metres per glTF unit.
    """

    vertices_rest: Float64[np.ndarray, "vertices 3"]
    faces: Int64[np.ndarray, "faces 3"]
    uv: Float64[np.ndarray, "vertices 2"] | None
    weights: Float64[np.ndarray, "vertices joints"]
    vertices_bind: Float64[np.ndarray, "vertices 3"]
    scale_to_m: float

    @property
    def rigged(self) -> bool:
        """True if the template has joints."""
        return len(self.joint_nodes) > 0

    @property
    def root_joints(self) -> Int64[np.ndarray, " roots"]:
        """Joints without a parent joint."""
        return np.flatnonzero(self.parents < 0)

    @property
    def joints_rest(self) -> Float64[np.ndarray, "joints 3"]:
        """Positions of the joints in the rest pose, metres."""
        return self.scale_to_m * joint_transforms(self, self.rest_rotations[None])[0, :, :3, 3]


def joints_in_order(parents: Int64[np.ndarray, " joints"]) -> list[int]:
    """Joint indices so that every parent comes before its children.

    A skin may list them in any order.
    """
    order: list[int] = []
    waiting = list(np.flatnonzero(parents < 0))
    while waiting:
        joint = int(waiting.pop(0))
        order.append(joint)
        waiting += list(np.flatnonzero(parents == joint))
    return order


def joint_transforms(
    template: Template, joint_rotations: Float64[np.ndarray, "frames joints 4"]
) -> Float64[np.ndarray, "frames joints 4 4"]:
    """Global transforms G_j in glTF units, from local rotations (quaternions wxyz)."""
    local = np.zeros((*joint_rotations.shape[:2], 4, 4))
    local[..., :3, :3], local[..., 3, 3] = matrix_from_quaternion(joint_rotations), 1.0
    local = template.before @ local @ template.after
    result = np.empty_like(local)
    for joint in joints_in_order(template.parents):
        parent = template.parents[joint]
        result[:, joint] = local[:, joint] if parent < 0 else result[:, parent] @ local[:, joint]
    return result


def blended_transforms(
    template: Template, joint_rotations: Float64[np.ndarray, "frames joints 4"]
) -> Float64[np.ndarray, "frames vertices 3 4"]:
    """Transform that linear-blend skinning applies to each vertex, glTF units."""
    palette = (joint_transforms(template, joint_rotations) @ template.inverse_bind)[:, :, :3]
    return np.einsum("vj,fjab->fvab", template.weights, palette, optimize=True)


def skinned(
    template: Template, joint_rotations: Float64[np.ndarray, "frames joints 4"]
) -> Float64[np.ndarray, "frames vertices 3"]:
    """Vertices in template space, metres, from local joint rotations (linear-blend skinning)."""
    blended = blended_transforms(template, joint_rotations)
    homogeneous = np.concatenate([template.vertices_bind, np.ones((len(template.vertices_bind), 1))], 1)
    return template.scale_to_m * np.einsum("fvab,vb->fva", blended, homogeneous, optimize=True)


def posed(
    template: Template,
    root_rotation: Float64[np.ndarray, "frames 4"],
    root_translation: Float64[np.ndarray, "frames 3"],
    joint_rotations: Float64[np.ndarray, "frames joints 4"],
) -> Float64[np.ndarray, "frames vertices 3"]:
    """Vertices in the world, metres: ``root_rotation`` x skinned vertex + ``root_translation``.

    The root transform is world-from-template; root joints keep their rest rotation in `joint_rotations`. For an
    unrigged template, `joint_rotations` is [frames, 0, 4].
    """
    if template.rigged:
        vertices = skinned(template, joint_rotations)
    else:
        vertices = np.broadcast_to(template.vertices_rest, (len(root_rotation), *template.vertices_rest.shape))
    return vertices @ matrix_from_quaternion(root_rotation).transpose(0, 2, 1) + root_translation[:, None]
