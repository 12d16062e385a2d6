"""Write a mesh, with its skin if it has one, as glTF 2.0 binary.

The format: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64

from pipeline.base.files import written_whole
from pipeline.synthesis.skeleton import Skeleton
from pipeline.synthesis.skinning import INFLUENCES

_FLOAT, _UINT16, _UINT32 = 5126, 5123, 5125
_ARRAY_BUFFER, _ELEMENT_BUFFER = 34962, 34963
_GLB_MAGIC, _JSON_CHUNK, _BINARY_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942

FIRST_JOINT_NODE = 1
"""Node 0 carries the mesh; joint j of the skeleton is node j + 1."""


class _Buffer:
    """Collects arrays into one binary chunk with an accessor each."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, int]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(self, array: np.ndarray, kind: str, component: int, target: int | None = None) -> int:
        view: dict[str, int] = {"buffer": 0, "byteOffset": len(self.data), "byteLength": array.nbytes}
        if target is not None:
            view["target"] = target
        accessor: dict[str, Any] = {
            "bufferView": len(self.views), "componentType": component, "count": len(array), "type": kind,
        }  # fmt: skip
        if kind == "VEC3":
            accessor |= {"min": array.min(axis=0).tolist(), "max": array.max(axis=0).tolist()}
        self.data += np.ascontiguousarray(array).tobytes()
        self.data += b"\0" * (-len(self.data) % 4)
        self.views.append(view)
        self.accessors.append(accessor)
        return len(self.accessors) - 1


@dataclass(frozen=True)
class Skin:
    """Dense skin weights, at most `INFLUENCES` per vertex, and the joints they belong to."""

    weights: Float64[np.ndarray, "v joints"]
    skeleton: Skeleton


def write_glb(
    path: Path,
    *,
    vertices: Float64[np.ndarray, "v 3"],
    normals: Float64[np.ndarray, "v 3"],
    faces: Int64[np.ndarray, "f 3"],
    uv: Float64[np.ndarray, "v 2"] | None,
    units_per_m: float,
    skin: Skin | None = None,
) -> None:
    """Write a rest mesh; no material, texture or animation. Joint j of a skin is node `FIRST_JOINT_NODE + j`.

    Args:
        vertices: rest positions in metres; stored multiplied by `units_per_m`, like the joints.
        uv: glTF texture coordinates, or None to leave them out.
    """
    buffer = _Buffer()
    attributes = {
        "POSITION": buffer.add((vertices * units_per_m).astype("<f4"), "VEC3", _FLOAT, _ARRAY_BUFFER),
        "NORMAL": buffer.add(normals.astype("<f4"), "VEC3", _FLOAT, _ARRAY_BUFFER),
    }
    if uv is not None:
        attributes["TEXCOORD_0"] = buffer.add(uv.astype("<f4"), "VEC2", _FLOAT, _ARRAY_BUFFER)
    primitive = {
        "attributes": attributes, "mode": 4,
        "indices": buffer.add(faces.reshape(-1).astype("<u4"), "SCALAR", _UINT32, _ELEMENT_BUFFER),
    }  # fmt: skip
    content: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "pipeline.synthesis"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "template", "mesh": 0}],
        "meshes": [{"name": "template", "primitives": [primitive]}],
    }
    if skin is not None:
        _add_skin(content, attributes, buffer, skin, units_per_m)
    content |= {
        "buffers": [{"byteLength": len(buffer.data)}],
        "bufferViews": buffer.views,
        "accessors": buffer.accessors,
    }
    _write_chunks(path, content, bytes(buffer.data))


def _add_skin(
    content: dict[str, Any], attributes: dict[str, int], buffer: _Buffer, skin: Skin, units_per_m: float
) -> None:
    skeleton = skin.skeleton
    joints = np.argsort(-skin.weights, axis=1, kind="stable")[:, :INFLUENCES]
    strongest = np.take_along_axis(skin.weights, joints, axis=1)
    joints = np.where(strongest > 0, joints, 0)
    attributes["JOINTS_0"] = buffer.add(joints.astype("<u2"), "VEC4", _UINT16, _ARRAY_BUFFER)
    attributes["WEIGHTS_0"] = buffer.add(strongest.astype("<f4"), "VEC4", _FLOAT, _ARRAY_BUFFER)
    inverse_bind = np.tile(np.eye(4), (len(skeleton.names), 1, 1))
    inverse_bind[:, :3, 3] = -skeleton.positions * units_per_m
    # glTF stores matrices column by column.
    matrices = buffer.add(inverse_bind.transpose(0, 2, 1).reshape(-1, 16).astype("<f4"), "MAT4", _FLOAT)
    joint_nodes = list(range(FIRST_JOINT_NODE, FIRST_JOINT_NODE + len(skeleton.names)))
    content["scenes"][0]["nodes"].append(FIRST_JOINT_NODE)
    content["nodes"][0]["skin"] = 0
    content["nodes"] += _joint_nodes(skeleton, units_per_m)
    content["skins"] = [{"joints": joint_nodes, "inverseBindMatrices": matrices, "skeleton": FIRST_JOINT_NODE}]


def _joint_nodes(skeleton: Skeleton, units_per_m: float) -> list[dict[str, Any]]:
    nodes = []
    for joint, (name, parent) in enumerate(zip(skeleton.names, skeleton.parents, strict=True)):
        origin = skeleton.positions[parent] if parent >= 0 else np.zeros(3)
        node: dict[str, Any] = {
            "name": name, "translation": ((skeleton.positions[joint] - origin) * units_per_m).tolist(),
        }  # fmt: skip
        children = [FIRST_JOINT_NODE + child for child, its in enumerate(skeleton.parents) if its == joint]
        if children:
            node["children"] = children
        nodes.append(node)
    return nodes


def _write_chunks(path: Path, content: dict[str, Any], binary: bytes) -> None:
    text = json.dumps(content, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    length = 12 + 8 + len(text) + 8 + len(binary)
    with written_whole(path) as temporary:
        temporary.write_bytes(
            struct.pack("<III", _GLB_MAGIC, 2, length)
            + struct.pack("<II", len(text), _JSON_CHUNK) + text
            + struct.pack("<II", len(binary), _BINARY_CHUNK) + binary
        )  # fmt: skip
