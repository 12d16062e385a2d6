"""Template meshes from glTF files: the rest mesh, its skeleton, and the weights."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError, listed
from pipeline.geometry.gltf import GltfFile, Primitive, by_the_specification
from pipeline.geometry.rotations import quaternion_from_matrix
from pipeline.geometry.skin import Skeleton, Template, skinned

NO_SKELETON = Skeleton(
    np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 4, 4)), np.zeros((0, 4, 4)), np.zeros((0, 4)),
    np.zeros((0, 4, 4)),
)  # fmt: skip


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
    skeleton = _read_skeleton(file, skin_indices.pop()) if skin_indices else NO_SKELETON
    bound = [_bind(file, primitive, skeleton) for primitive in primitives]
    vertices_bind, weights = np.concatenate([v for v, _ in bound]), np.concatenate([w for _, w in bound])
    template = Template(
        vertices_rest=scale_to_m * vertices_bind, faces=faces, uv=uv, **vars(skeleton), weights=weights,
        vertices_bind=vertices_bind, scale_to_m=float(scale_to_m),
    )  # fmt: skip
    if not template.rigged:
        return template
    return replace(template, vertices_rest=skinned(template, template.rest_rotations[None])[0])


def _read_skeleton(file: GltfFile, skin_index: int) -> Skeleton:
    """Joints of one skin: nodes that are no joints are folded into `before` of the joints below them."""
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
    inverse_bind = _read_inverse_bind(file, skin.inverseBindMatrices, len(joints), where)
    return Skeleton(joints, parents, before, after, rotations, inverse_bind)


def _read_inverse_bind(file: GltfFile, accessor: int | None, joints: int, where: str) -> np.ndarray:
    """Read inverse bind matrices [joints, 4, 4]; identities if the skin has no accessor, as glTF says."""
    if accessor is None:
        return np.tile(np.eye(4), (joints, 1, 1))
    stored = file.accessor(accessor)
    if stored.shape != (joints, 16) or not np.isfinite(stored).all():
        found = f"{len(stored)} of {stored.shape[1]} numbers, {int((~np.isfinite(stored)).sum())} not finite"
        raise InputError(
            f"{where}.inverseBindMatrices: expected {joints} finite 4x4 matrices, found {found}; export anew"
        )
    return stored.reshape(-1, 4, 4).transpose(0, 2, 1).copy()


def _bind(file: GltfFile, primitive: Primitive, skeleton: Skeleton) -> tuple[np.ndarray, np.ndarray]:
    """Vertices before skinning, and dense weights, of one primitive."""
    joint_count, count = len(skeleton.joint_nodes), len(primitive.positions)
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
        nodes = skeleton.joint_nodes.tolist()
        above = primitive.node
        while above >= 0 and above not in nodes:
            above = file.parents[above]
        joint = nodes.index(above) if above >= 0 else int(np.flatnonzero(skeleton.parents < 0)[0])
        weights[:, joint] = 1.0
        # Undo what skinning will do in the rest pose, so that the rest pose is where the node puts the mesh.
        in_scene = np.linalg.inv(file.scene_from_node(nodes[joint]) @ skeleton.inverse_bind[joint]) @ in_scene
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
