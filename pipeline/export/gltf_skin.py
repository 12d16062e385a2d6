"""Joints of a template as nodes of glTF, its skin, and how both move.

Everything is in metres: a joint's transform G in the template's unit becomes S G S^-1, S = diag(s, s, s, 1) with s the
unit in metres, which changes translations alone. Above the joints stands a node that places the template in the stage.

Source: Khronos glTF 2.0 specification, section 3.7.3 (skins).
"""

from __future__ import annotations

import numpy as np
import pygltflib
from jaxtyping import Float, Float64, Int64

from pipeline.export.glb import GlbFile
from pipeline.export.gltf_animation import Track
from pipeline.export.rigged_motion import RiggedMotion
from pipeline.geometry.skin import Template, joints_in_order

INFLUENCES = 4
"""Joints in one set of attributes."""

STRAIGHT = 1e-9
"""Shear of a joint's scale below which it is rounding: float64 keeps 1e-16 of what a decomposition leaves."""


def add_skin(file: GlbFile, motion: RiggedMotion) -> list[Track]:
    """Append the joints, posed as in the first frame, and the skin; returns their motion."""
    template, pose = motion.template, motion.pose
    turns, root_turns = continuous(pose.joint_rotations), continuous(pose.root_rotation)
    stand = file.add_node(
        pygltflib.Node(
            name="skeleton", translation=pose.root_translation[0].tolist(), rotation=root_turns[0].tolist()
        )
    )  # fmt: skip
    tracks = [Track(stand, "translation", pose.root_translation), Track(stand, "rotation", root_turns)]
    moving: dict[int, int] = {}
    for joint in joints_in_order(template.parents):
        above = moving.get(int(template.parents[joint]), stand)
        turned, moving[joint] = add_joint(file, motion, joint, turns[0, joint], above)
        tracks.append(Track(turned, "rotation", turns[:, joint]))
    file.document.skins.append(
        pygltflib.Skin(
            name="skin", joints=[moving[joint] for joint in range(len(template.parents))], skeleton=stand,
            inverseBindMatrices=file.add(by_columns(in_metres(template.inverse_bind, template.scale_to_m))),
        )
    )  # fmt: skip
    return tracks


def add_joint(
    file: GlbFile, motion: RiggedMotion, joint: int, rotation: Float64[np.ndarray, " 4"], parent: int
) -> tuple[int, int]:
    """Append a joint; returns the node that turns, and the one that moves the skin.

    They are the same, but where a scale is sheared; the second has the children. Transforms above it that are more than
    a translation, as of an armature in centimetres, stand in a node of their own.
    """
    template, name = motion.template, motion.joint_names[joint]
    before = in_metres(template.before[joint], template.scale_to_m)
    after, shift = template.after[joint], before[:3, 3]
    if not np.array_equal(before[:3, :3], np.eye(3)):
        parent = file.add_node(
            pygltflib.Node(name=f"above {name}", matrix=by_columns(before[None])[0].tolist()), parent
        )
        shift = np.zeros(3)
    scale = np.diag(after)[:3]
    sheared = np.abs(after[:3, :3] - np.diag(scale)).max() > STRAIGHT * np.abs(scale).max()
    node = pygltflib.Node(name=name, translation=shift.tolist(), rotation=rotation.tolist())
    if not sheared and not np.array_equal(scale, np.ones(3)):
        node.scale = scale.tolist()
    turned = file.add_node(node, parent)
    if not sheared:
        return turned, turned
    return turned, file.add_node(
        pygltflib.Node(name=f"{name} shape", matrix=by_columns(after[None])[0].tolist()), turned
    )


def skin_attributes(file: GlbFile, template: Template, vertex: Int64[np.ndarray, " n"]) -> dict[str, int]:
    """Accessors JOINTS_n and WEIGHTS_n of these vertices.

    There are as many sets as the vertex of most joints needs.
    """
    weights = template.weights[vertex]
    most = int((weights > 0).sum(1).max())
    sets = -(-most // INFLUENCES)
    joints = np.argsort(-weights, axis=1, kind="stable")[:, : INFLUENCES * sets]
    strongest = np.take_along_axis(weights, joints, axis=1)
    missing = INFLUENCES * sets - joints.shape[1]  # of a skin with fewer joints than a set
    joints, strongest = (
        np.pad(each, ((0, 0), (0, missing))) for each in (np.where(strongest > 0, joints, 0), strongest)
    )
    found = {}
    for k in range(sets):
        columns = slice(INFLUENCES * k, INFLUENCES * (k + 1))
        found[f"JOINTS_{k}"] = file.add(joints[:, columns].astype("<u2"), pygltflib.ARRAY_BUFFER)
        found[f"WEIGHTS_{k}"] = file.add_vertices(strongest[:, columns])
    return found


def continuous(quaternions: Float64[np.ndarray, "frames *some 4"]) -> Float64[np.ndarray, "frames *some 4"]:
    """The same rotations as x, y, z, w of unit length, each on the side of the one before.

    q and -q are one rotation, but not what lies between them and another.
    """
    unit = quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True)
    turned = np.sign((unit[1:] * unit[:-1]).sum(-1, keepdims=True))
    signs = np.cumprod(np.where(turned < 0, -1.0, 1.0), axis=0)
    return np.roll(np.concatenate([unit[:1], signs * unit[1:]]), -1, axis=-1)


def in_metres(transforms: Float64[np.ndarray, "*some 4 4"], scale_to_m: float) -> Float64[np.ndarray, "*some 4 4"]:
    """Transforms of points in metres, from those of points in the template's unit."""
    result = transforms.copy()
    result[..., :3, 3] *= scale_to_m
    return result


def by_columns(matrices: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 16"]:
    """As glTF stores matrices, float32."""
    return matrices.swapaxes(1, 2).reshape(-1, 16).astype("<f4")
