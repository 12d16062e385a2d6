"""Meshes, node transforms and skins from glTF 2.0 binary files (.glb).

Source: Khronos glTF 2.0 specification, sections 3.6 (accessors), 3.7 (meshes, skins) and 3.5 (nodes).
"""

from __future__ import annotations

import base64
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pygltflib
from jaxtyping import Float64

from pipeline.base.errors import InputError
from pipeline.geometry.gltf_nodes import parents_of
from pipeline.geometry.rotations import matrix_from_quaternion

COMPONENT_DTYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
COMPONENT_COUNTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
COMPRESSED = {"KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression"}
"""Extensions that hide vertex data from a plain accessor."""

TRIANGLES = 4
MAX_INFLUENCE_SETS = 4
"""JOINTS_0 .. JOINTS_3 are read: 16 joints per vertex, twice what authoring tools export."""

MOST_ELEMENTS = 2**26
"""Elements of an accessor that are read, 67 million: a hundred times the largest template, and still few gigabytes. A
file of some bytes may ask for any number of zeros."""


@contextmanager
def by_the_specification(path: Path) -> Iterator[None]:
    """Refuse a file at which the block fails; its JSON part may say anything.

    Raises:
        InputError: in place of what a reference to nothing, an unknown type, or text for a number raises.
    """
    try:
        yield
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        found = f"a file that does not keep to it ({type(error).__name__}: {error})"
        raise InputError(
            f"{path}: expected a mesh by the glTF 2.0 specification, found {found}; export it anew"
        ) from error


@dataclass(frozen=True)
class Primitive:
    """One glTF primitive as it lies in the file, no transform applied.

    `joints` index into the skin's joint list.
    """

    node: int
    positions: np.ndarray
    faces: np.ndarray
    uv: np.ndarray | None
    joints: np.ndarray | None
    weights: np.ndarray | None


class GltfFile:
    """A .glb file: its accessors, node transforms, primitives and skin.

    Attributes:
        path: the file, for messages.
        document: pygltflib's view of the JSON part.
        parents: per node, the index of its parent node, or -1.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        try:
            self.document = pygltflib.GLTF2.load_binary(str(path)) if self.path.is_file() else None
        except Exception as error:  # pygltflib raises whatever its parts raise; to a person all of it is "not a .glb".
            raise InputError(f"{path}: expected a glTF 2.0 binary (.glb), found: {error}") from error
        if self.document is None:
            raise InputError(f"{path}: expected a glTF 2.0 binary (.glb), found no such file or another format")
        compressed = sorted(COMPRESSED & set(self.document.extensionsRequired or []))
        if compressed:
            raise InputError(f"{path}: extensionsRequired: expected none of {compressed}; re-export plainly")
        self.parents = parents_of(self.document.nodes, self.path)

    def _buffer(self, index: int) -> bytes:
        uri = self.document.buffers[index].uri
        if uri is None:
            return self.document.binary_blob()
        if uri.startswith("data:"):
            return base64.b64decode(uri.split(",", 1)[1])
        raise InputError(f"{self.path}: buffers[{index}]: expected data in the .glb, found {uri}; embed it")

    def _view(self, view_index: int, offset: int, dtype: np.dtype, count: int, components: int) -> np.ndarray:
        """`count` x `components` numbers from a buffer view, honouring its stride."""
        view = self.document.bufferViews[view_index]
        stride = view.byteStride or dtype.itemsize * components
        start = (view.byteOffset or 0) + (offset or 0)
        shape, strides = (count, components), (stride, dtype.itemsize)
        buffer = self._buffer(view.buffer)
        if start + stride * (count - 1) + dtype.itemsize * components > len(buffer):
            raise InputError(
                f"{self.path}: bufferViews[{view_index}]: expected {count} x {components} {dtype} from byte {start}, "
                f"found {len(buffer)} bytes in all; the file is damaged, export it anew"
            )
        return np.ndarray(shape, dtype, buffer, start, strides).copy()

    def accessor(self, index: int) -> np.ndarray:
        """Accessor `index` as [count, components].

        float64 if it holds floats or normalised integers, else int64.
        """
        accessor = self.document.accessors[index]
        dtype, components = np.dtype(COMPONENT_DTYPES[accessor.componentType]), COMPONENT_COUNTS[accessor.type]
        if not 0 < accessor.count <= MOST_ELEMENTS:
            expected = f"1 to {MOST_ELEMENTS} elements"
            raise InputError(f"{self.path}: accessors[{index}].count: expected {expected}, found {accessor.count}")
        if accessor.bufferView is None:
            values = np.zeros((accessor.count, components), dtype)
        else:
            values = self._view(accessor.bufferView, accessor.byteOffset, dtype, accessor.count, components)
        if accessor.sparse is not None:
            sparse = accessor.sparse
            where = sparse.indices
            index_dtype = np.dtype(COMPONENT_DTYPES[where.componentType])
            rows = self._view(where.bufferView, where.byteOffset, index_dtype, sparse.count, 1)[:, 0]
            data = sparse.values
            values[rows] = self._view(data.bufferView, data.byteOffset, dtype, sparse.count, components)
        if dtype.kind == "f":
            return values.astype(np.float64)
        if accessor.normalized:
            return np.maximum(values / np.iinfo(dtype).max, -1.0)
        return values.astype(np.int64)

    def local_parts(self, index: int) -> tuple[Float64[np.ndarray, " 3"], Float64[np.ndarray, "3 3"], np.ndarray]:
        """Translation, rotation and the remaining 3x3 (scale, any shear) of a node: M = T R S."""
        node = self.document.nodes[index]
        if node.matrix is not None:
            matrix = np.array(node.matrix, np.float64).reshape(4, 4).T
            # Polar decomposition: the rotation nearest to the 3x3; what is left is symmetric scale and shear.
            u, _, vt = np.linalg.svd(matrix[:3, :3])
            rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
            return matrix[:3, 3], rotation, rotation.T @ matrix[:3, :3]
        x, y, z, w = node.rotation if node.rotation is not None else (0.0, 0.0, 0.0, 1.0)
        translation = np.array(node.translation if node.translation is not None else (0.0, 0.0, 0.0))
        scale = np.diag(node.scale if node.scale is not None else (1.0, 1.0, 1.0)).astype(np.float64)
        return translation, matrix_from_quaternion(np.array([w, x, y, z], np.float64)), scale

    def parent_from_node(self, index: int) -> Float64[np.ndarray, "4 4"]:
        """A node's local transform."""
        translation, rotation, scale = self.local_parts(index)
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = rotation @ scale, translation
        return matrix

    def scene_from_node(self, index: int) -> Float64[np.ndarray, "4 4"]:
        """A node's global transform: itself and all its ancestors, joints or not."""
        matrix = self.parent_from_node(index)
        while (index := self.parents[index]) >= 0:
            matrix = self.parent_from_node(index) @ matrix
        return matrix

    def primitives(self) -> list[Primitive]:
        """Every triangle primitive that a node shows.

        In the order of the file's meshes and primitives.

        Raises:
            InputError: if there is none, or one is not made of triangles.
        """
        found = []
        for mesh_index, mesh in enumerate(self.document.meshes):
            for node_index, node in enumerate(self.document.nodes):
                if node.mesh == mesh_index:
                    found += [self._primitive(node_index, mesh_index, i) for i in range(len(mesh.primitives))]
        if not found:
            raise InputError(f"{self.path}: meshes: expected at least one mesh in a node, found none")
        return found

    def _primitive(self, node: int, mesh: int, index: int) -> Primitive:
        primitive = self.document.meshes[mesh].primitives[index]
        where = f"{self.path}: meshes[{mesh}].primitives[{index}]"
        if primitive.mode not in (None, TRIANGLES):
            raise InputError(f"{where}: expected triangles (mode 4), found mode {primitive.mode}; triangulate")
        attributes = primitive.attributes
        if attributes.POSITION is None:
            raise InputError(f"{where}: expected POSITION, found none")
        positions = self.accessor(attributes.POSITION).astype(np.float64)
        count = len(positions)
        if bad := int((~np.isfinite(positions)).any(1).sum()):
            raise InputError(f"{where}.POSITION: expected finite numbers, found {bad} of {count} vertices without")
        indices = np.arange(count) if primitive.indices is None else self.accessor(primitive.indices)[:, 0]
        if len(indices) < 3:
            raise InputError(f"{where}: expected at least one triangle, found {len(indices)} indices")
        if len(indices) % 3 or (len(indices) and not 0 <= indices.min() <= indices.max() < count):
            found = f"{len(indices)} up to {indices.max()}"
            raise InputError(f"{where}: indices: expected triples below {count}, found {found}")
        uv = None if attributes.TEXCOORD_0 is None else self.accessor(attributes.TEXCOORD_0)
        sets = [i for i in range(MAX_INFLUENCE_SETS) if getattr(attributes, f"JOINTS_{i}", None) is not None]
        skinned = bool(sets) and self.document.nodes[node].skin is not None
        joints = [self.accessor(getattr(attributes, f"JOINTS_{i}")) for i in sets] if skinned else None
        weights = [self.accessor(getattr(attributes, f"WEIGHTS_{i}")) for i in sets] if skinned else None
        return Primitive(
            node, positions, indices.reshape(-1, 3), uv,
            np.concatenate(joints, 1) if joints else None, np.concatenate(weights, 1) if weights else None,
        )  # fmt: skip
