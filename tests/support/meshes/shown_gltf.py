"""Vertices that a viewer of glTF shows at a keyframe: animation, morph targets and skin, after the specification.

None of the pipeline's modules is used.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pygltflib
from scipy.spatial.transform import Rotation

DTYPES = {5123: "<u2", 5125: "<u4", 5126: "<f4"}
COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class ShownGltf:
    """One mesh of a .glb with one animation.

    Attributes:
        document: pygltflib's view of the file.
        node: the index of the node with the mesh.
        primitive: the only one of the mesh.
    """

    def __init__(self, path: Path) -> None:
        self.document = pygltflib.GLTF2().load(str(path))
        nodes = self.document.nodes
        self.parents = {child: parent for parent, node in enumerate(nodes) for child in node.children}
        (self.node,) = (index for index, node in enumerate(nodes) if node.mesh is not None)
        (self.primitive,) = self.document.meshes[nodes[self.node].mesh].primitives

    def column(self, index: int) -> np.ndarray:
        """An accessor as [count, components]."""
        accessor = self.document.accessors[index]
        start = self.document.bufferViews[accessor.bufferView].byteOffset
        count, dtype = COMPONENTS[accessor.type], DTYPES[accessor.componentType]
        values = np.frombuffer(self.document.binary_blob(), dtype, accessor.count * count, start)
        return values.reshape(accessor.count, count)

    def attribute(self, name: str) -> np.ndarray:
        """An attribute of the vertices."""
        return self.column(getattr(self.primitive.attributes, name))

    @property
    def faces(self) -> np.ndarray:
        """Indices of vertices."""
        return self.column(self.primitive.indices).reshape(-1, 3)

    @property
    def seconds(self) -> np.ndarray:
        """Moments of the animation's keys."""
        (animation,) = self.document.animations
        return self.column(animation.samplers[0].input)[:, 0]

    def animated(self, key: int | None) -> dict[tuple[int, str], np.ndarray]:
        """Values by node and property at a key; none of the file as it lies."""
        if key is None:
            return {}
        (animation,), found = self.document.animations, {}
        for channel in animation.channels:
            values = self.column(animation.samplers[channel.sampler].output)
            values = values.reshape(len(self.seconds), -1).astype(np.float64)
            found[channel.target.node, channel.target.path] = values[key]
        return found

    def world(self, node: int, moved: dict) -> np.ndarray:
        """A node's global transform."""
        one = self.document.nodes[node]
        if one.matrix is not None:
            matrix = np.array(one.matrix).reshape(4, 4).T
        else:
            matrix = np.eye(4)
            turn = moved.get((node, "rotation"), one.rotation or [0, 0, 0, 1])
            matrix[:3, :3] = Rotation.from_quat(turn).as_matrix() * (one.scale or [1, 1, 1])
            matrix[:3, 3] = moved.get((node, "translation"), one.translation or [0, 0, 0])
        return self.world(self.parents[node], moved) @ matrix if node in self.parents else matrix

    def vertices(self, key: int | None = None) -> np.ndarray:
        """Vertices in the scene at a key of the animation, or as the file lies."""
        moved = self.animated(key)
        place = self.attribute("POSITION").astype(np.float64)
        mesh = self.document.meshes[self.document.nodes[self.node].mesh]
        weights = moved.get((self.node, "weights"), mesh.weights or [])
        for weight, target in zip(weights, self.primitive.targets, strict=True):
            place = place + weight * self.column(target["POSITION"])
        if self.document.nodes[self.node].skin is None:
            return place
        skin = self.document.skins[self.document.nodes[self.node].skin]
        bind = self.column(skin.inverseBindMatrices).astype(np.float64).reshape(-1, 4, 4).swapaxes(1, 2)
        joints = np.stack([self.world(node, moved) for node in skin.joints]) @ bind
        homogeneous, shown = np.concatenate([place, np.ones((len(place), 1))], 1), 0.0
        sets = [name for name in vars(self.primitive.attributes) if name.startswith("JOINTS_")]
        for name in (each for each in sets if getattr(self.primitive.attributes, each) is not None):
            weight = self.attribute(name.replace("JOINTS", "WEIGHTS"))
            shown = shown + np.einsum("vk,vkab,vb->va", weight, joints[self.attribute(name)], homogeneous)
        return shown[:, :3]
