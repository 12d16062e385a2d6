"""A skinned figure of glTF by the specification's formulas alone: no library, float64, a few lines."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from pipeline.geometry.skin import skinned
from pipeline.geometry.template_file import read_template

COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
NUMBERS = {5121: np.uint8, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
"""Sizes and types of glTF's accessors."""


class Glb:
    """Numbers of a binary glTF file, by its specification and without a library."""

    def __init__(self, path: Path) -> None:
        """Read the file."""
        stored = path.read_bytes()
        length = int.from_bytes(stored[12:16], "little")
        self.document, self.binary = json.loads(stored[20 : 20 + length]), stored[28 + length :]

    def numbers(self, accessor: int) -> np.ndarray:
        """Rows of an accessor, floats as float64."""
        described = self.document["accessors"][accessor]
        view = self.document["bufferViews"][described["bufferView"]]
        kind, columns = np.dtype(NUMBERS[described["componentType"]]), COMPONENTS[described["type"]]
        rows = np.ndarray(
            (described["count"], columns), kind, self.binary,
            view.get("byteOffset", 0) + described.get("byteOffset", 0),
            (view.get("byteStride", columns * kind.itemsize), kind.itemsize),
        )  # fmt: skip
        return rows.astype(np.float64 if kind == np.float32 else np.int64)

    def key_rotations(self) -> dict[int, Float64[np.ndarray, "keys 4"]]:
        """Rotations of the first clip's keys by node, xyzw."""
        clip = self.document["animations"][0]
        return {
            channel["target"]["node"]: self.numbers(clip["samplers"][channel["sampler"]]["output"])
            for channel in clip["channels"] if channel["target"]["path"] == "rotation"
        }  # fmt: skip

    def world(self, node: int, rotations: dict[int, np.ndarray]) -> Float64[np.ndarray, "4 4"]:
        """Scene-from-node, with some nodes' rotations replaced."""
        entry, local = self.document["nodes"][node], np.eye(4)
        if "matrix" in entry:
            local = np.array(entry["matrix"], np.float64).reshape(4, 4).T
        else:
            turn = Rotation.from_quat(rotations.get(node, entry.get("rotation", [0, 0, 0, 1]))).as_matrix()
            local[:3, :3], local[:3, 3] = turn * entry.get("scale", [1, 1, 1]), entry.get("translation", [0, 0, 0])
        above = [k for k, other in enumerate(self.document["nodes"]) if node in other.get("children", ())]
        return self.world(above[0], rotations) @ local if above else local

    def weights(self) -> Float64[np.ndarray, "vertices 4"]:
        """Skinning weights of the first mesh, as they are stored."""
        return self.numbers(self.document["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"])

    def posed(self, rotations: dict[int, np.ndarray]) -> Float64[np.ndarray, "vertices 3"]:
        """Vertices of the first mesh under the first skin: sum_j w_j G_j B_j v / sum_j w_j."""
        skin, has = self.document["skins"][0], self.document["meshes"][0]["primitives"][0]["attributes"]
        bind = self.numbers(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
        palette = np.stack([self.world(node, rotations) for node in skin["joints"]]) @ bind
        weights, positions = self.weights(), self.numbers(has["POSITION"])
        weights = weights / weights.sum(1, keepdims=True)
        blended = np.einsum("vk,vkab->vab", weights, palette[self.numbers(has["JOINTS_0"])])
        return np.einsum("vab,vb->va", blended[:, :3, :3], positions) + blended[:, :3, 3]


def posed_both_ways(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices [keys, vertices, 3] at every key of a clip's rotations, by the pipeline and by definition."""
    template, glb = read_template(path, 1.0), Glb(path)
    turned = glb.key_rotations()
    keys = len(next(iter(turned.values())))
    rotations = np.tile(template.rest_rotations, (keys, 1, 1))
    for joint, node in enumerate(template.joint_nodes.tolist()):
        if node in turned:
            rotations[:, joint] = turned[node][:, [3, 0, 1, 2]]
    return skinned(template, rotations), np.stack(
        [glb.posed({n: r[k] for n, r in turned.items()}) for k in range(keys)]
    )
