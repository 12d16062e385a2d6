"""Template meshes and linear-blend skinning.

Rest pose, joints, weights, and the posed vertices of every frame.

A vertex v of a rigged template is, in template space (metres, before the root transform),
``scale_to_m * sum_j w_vj G_j B_j v``: B_j the inverse bind matrices, G_j the joints' global transforms. Each joint is
``G_j = G_parent @ before_j @ R_j @ after_j``: `before` is its translation and any non-joint nodes above it, R_j its
local rotation, `after` its scale. Source: glTF 2.0 specification, section 3.7.3 (skins).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64

from pipeline.base.errors import InputError, listed
from pipeline.geometry.gltf import GltfFile, Primitive, by_the_specification
from pipeline.geometry.rotations import matrix_from_quaternion, quaternion_from_matrix


@dataclass(frozen=True)
class Template:
    """A template mesh in the glTF file's vertex order (primitives concatenated), rigged or not.

    Attributes:
        vertices_rest: the skinned rest pose (unrigged: the mesh under its node's transform), metres.
        faces: vertex indices per triangle.
        uv: texture coordinates per vertex (glTF: v points down), or None if a primitive has none.
        joint_nodes: glTF node index per joint, in the skin's order; empty if unrigged.
        parents: index of the parent *joint*, or -1.
        before, after: the fixed 4x4 parts of each joint's local transform (module docstring), glTF units.
        rest_rotations: local rotations in the rest pose, quaternions wxyz.
        inverse_bind: inverse bind matrices.
        weights: skinning weights, dense; rows sum to 1.
        vertices_bind: vertices before skinning, glTF units.
        scale_to_m: metres per glTF unit.
    """

    vertices_rest: Float64[np.ndarray, "vertices 3"]
    faces: Int64[np.ndarray, "faces 3"]
    uv: Float64[np.ndarray, "vertices 2"] | None
    joint_nodes: Int64[np.ndarray, " joints"]
    parents: Int64[np.ndarray, " joints"]
    before: Float64[np.ndarray, "joints 4 4"]
    after: Float64[np.ndarray, "joints 4 4"]
    rest_rotations: Float64[np.ndarray, "joints 4"]
    inverse_bind: Float64[np.ndarray, "joints 4 4"]
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


def read_template(path: Path, scale_to_m: float) -> Template:
    """Read a .glb template; `scale_to_m` is metres per glTF unit.

    Morph targets are ignored. Primitives without a skin in a rigged file follow the nearest joint above their node
    (else the first root joint).

    Raises:
        InputError: if the file is not a .glb of triangles, holds several skins, or a vertex has no weight.
    """
    with by_the_specification(path):
        return _read_template(path, scale_to_m)


def read_joint_names(path: Path, template: Template) -> list[str]:
    """Names of a template's joints, in the skin's order; a joint without one is `joint 3`."""
    nodes = GltfFile(path).document.nodes
    return [nodes[node].name or f"joint {joint}" for joint, node in enumerate(template.joint_nodes.tolist())]


def _read_template(path: Path, scale_to_m: float) -> Template:
    file = GltfFile(path)
    primitives = file.primitives()
    skin_indices = {file.document.nodes[p.node].skin for p in primitives if p.joints is not None}
    if len(skin_indices) > 1:
        raise InputError(f"{path}: skins: expected one skin, found {len(skin_indices)}; merge the armatures")
    first = np.cumsum([0] + [len(p.positions) for p in primitives])
    faces = np.concatenate([p.faces + start for p, start in zip(primitives, first, strict=False)]).astype(np.int64)
    charted = all(p.uv is not None for p in primitives)
    uv = np.concatenate([p.uv for p in primitives]).astype(np.float64) if charted else None
    skeleton = _read_skeleton(file, skin_indices.pop()) if skin_indices else _no_skeleton()
    bound = [_bind(file, primitive, skeleton) for primitive in primitives]
    vertices_bind, weights = np.concatenate([v for v, _ in bound]), np.concatenate([w for _, w in bound])
    template = Template(
        vertices_rest=scale_to_m * vertices_bind, faces=faces, uv=uv, **skeleton, weights=weights,
        vertices_bind=vertices_bind, scale_to_m=float(scale_to_m),
    )  # fmt: skip
    if not template.rigged:
        return template
    rest = skinned(template, template.rest_rotations[None])[0]
    return Template(**{**vars(template), "vertices_rest": rest})


def _no_skeleton() -> dict[str, np.ndarray]:
    none = np.zeros((0, 4, 4))
    integers = np.zeros(0, np.int64)
    return {"joint_nodes": integers, "parents": integers, "before": none, "after": none, "inverse_bind": none,
            "rest_rotations": np.zeros((0, 4))}  # fmt: skip


def _read_skeleton(file: GltfFile, skin_index: int) -> dict[str, np.ndarray]:
    """Joint tables of one skin: nodes that are no joints are folded into `before` of the joints below them."""
    skin = file.document.skins[skin_index]
    joints = np.array(skin.joints, np.int64)
    nodes, where = len(file.document.nodes), f"{file.path}: skins[{skin_index}]"
    if not len(joints) or len(set(joints)) < len(joints) or not 0 <= joints.min() <= joints.max() < nodes:
        raise InputError(f"{where}.joints: expected different nodes, 0 to {nodes - 1}, found {listed(skin.joints, 30)}")
    joint_of_node = {int(node): joint for joint, node in enumerate(joints)}
    parents, before = np.full(len(joints), -1, np.int64), np.tile(np.eye(4), (len(joints), 1, 1))
    after, rotations = before.copy(), np.zeros((len(joints), 4))
    for joint, node in enumerate(joints):
        translation, rotation, scale = file.local_parts(int(node))
        before[joint, :3, 3], after[joint, :3, :3] = translation, scale
        rotations[joint] = quaternion_from_matrix(rotation)
        above = file.parents[int(node)]
        while above >= 0 and above not in joint_of_node:
            before[joint] = file.parent_from_node(above) @ before[joint]
            above = file.parents[above]
        parents[joint] = joint_of_node.get(above, -1)
    if skin.inverseBindMatrices is None:
        inverse_bind = np.tile(np.eye(4), (len(joints), 1, 1))
    else:
        stored = file.accessor(skin.inverseBindMatrices)
        if stored.shape != (len(joints), 16) or not np.isfinite(stored).all():
            found = f"{len(stored)} of {stored.shape[1]} numbers, {int((~np.isfinite(stored)).sum())} not finite"
            raise InputError(
                f"{where}.inverseBindMatrices: expected {len(joints)} finite 4x4 matrices, found {found}; export anew"
            )
        inverse_bind = stored.reshape(-1, 4, 4).transpose(0, 2, 1).copy()
    return {"joint_nodes": joints, "parents": parents, "before": before, "after": after, "inverse_bind": inverse_bind,
            "rest_rotations": rotations}  # fmt: skip


def _bind(file: GltfFile, primitive: Primitive, skeleton: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Vertices before skinning, and dense weights, of one primitive."""
    joint_count, count = len(skeleton["joint_nodes"]), len(primitive.positions)
    weights = np.zeros((count, joint_count))
    if primitive.joints is not None:
        _require_influences(file, primitive, joint_count)
        # glTF: the transform of the node that holds a skinned mesh is ignored.
        np.add.at(weights, (np.arange(count)[:, None], primitive.joints), primitive.weights)
        total = weights.sum(1, keepdims=True)
        if not (total > 0).all():
            raise InputError(
                f"{file.path}: WEIGHTS_0 of node {primitive.node}: expected a positive weight at every vertex, found "
                f"{int((total <= 0).sum())} of {count} vertices without; weight them to a joint"
            )
        return primitive.positions, weights / total
    homogeneous = np.concatenate([primitive.positions, np.ones((count, 1))], 1)
    in_scene = file.scene_from_node(primitive.node)
    if joint_count:
        nodes = skeleton["joint_nodes"].tolist()
        above = primitive.node
        while above >= 0 and above not in nodes:
            above = file.parents[above]
        joint = nodes.index(above) if above >= 0 else int(np.flatnonzero(skeleton["parents"] < 0)[0])
        weights[:, joint] = 1.0
        # Undo what skinning will do in the rest pose, so that the rest pose is where the node puts the mesh.
        in_scene = np.linalg.inv(file.scene_from_node(nodes[joint]) @ skeleton["inverse_bind"][joint]) @ in_scene
    return (homogeneous @ in_scene.T)[:, :3], weights


def _require_influences(file: GltfFile, primitive: Primitive, joints: int) -> None:
    """Refuse weights that are no weights, or of joints that the skin does not have.

    Raises:
        InputError: naming the attribute.
    """
    where = f"{file.path}: node {primitive.node}"
    if primitive.joints.shape != primitive.weights.shape or len(primitive.joints) != len(primitive.positions):
        found = f"{primitive.joints.shape} and {primitive.weights.shape} of {len(primitive.positions)} vertices"
        raise InputError(f"{where}: JOINTS_n and WEIGHTS_n: expected as many rows as vertices, found {found}")
    if not 0 <= primitive.joints.min() <= primitive.joints.max() < joints:
        found = f"{primitive.joints.min()} to {primitive.joints.max()}"
        raise InputError(f"{where}: JOINTS_n: expected joints of the skin, 0 to {joints - 1}, found {found}")
    if not (np.isfinite(primitive.weights) & (primitive.weights >= 0)).all():
        raise InputError(f"{where}: WEIGHTS_n: expected finite weights of 0 or more, found others")


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
