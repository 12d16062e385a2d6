"""Accessors, textures and nodes gathered into one glTF 2.0 binary file.

Source: Khronos glTF 2.0 specification, sections 3.6 (accessors), 3.8 (textures) and 4.4 (the binary container).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pygltflib
from jaxtyping import Float

from pipeline.base.files import written_whole

TYPES = {1: pygltflib.SCALAR, 2: pygltflib.VEC2, 3: pygltflib.VEC3, 4: pygltflib.VEC4, 16: pygltflib.MAT4}
COMPONENTS = {"f4": pygltflib.FLOAT, "u4": pygltflib.UNSIGNED_INT, "u2": pygltflib.UNSIGNED_SHORT}
ALIGNMENT = 4


class GlbFile:
    """A .glb file in the making: one scene, one buffer.

    Attributes:
        document: pygltflib's view of its JSON part; what has no method here is appended to it.
    """

    def __init__(self) -> None:
        self.document = pygltflib.GLTF2(
            asset=pygltflib.Asset(version="2.0", generator="lightstage-avatars"),
            scene=0, scenes=[pygltflib.Scene(nodes=[])],
        )  # fmt: skip
        self._content = bytearray()

    def add_view(self, content: bytes, target: int | None = None) -> int:
        """Append bytes to the buffer; returns the index of their view."""
        view = pygltflib.BufferView(buffer=0, byteOffset=len(self._content), byteLength=len(content), target=target)
        self._content += content + b"\0" * (-len(content) % ALIGNMENT)
        self.document.bufferViews.append(view)
        return len(self.document.bufferViews) - 1

    def add(self, array: np.ndarray, target: int | None = None, bounded: bool = False) -> int:
        """Append numbers; returns the index of their accessor.

        Args:
            array: [n] or [n, components], float32, uint32 or uint16; 16 components are a matrix, by columns.
            target: of the buffer view, for vertices and indices.
            bounded: minimum and maximum are said, which positions and times need.
        """
        rows = np.ascontiguousarray(array).reshape(len(array), -1)
        accessor = pygltflib.Accessor(
            bufferView=self.add_view(rows.tobytes(), target), componentType=COMPONENTS[rows.dtype.str[1:]],
            count=len(rows), type=TYPES[rows.shape[1]],
        )  # fmt: skip
        if bounded:
            accessor.min, accessor.max = rows.min(0).tolist(), rows.max(0).tolist()
        self.document.accessors.append(accessor)
        return len(self.document.accessors) - 1

    def add_vertices(self, array: Float[np.ndarray, " n *components"], bounded: bool = False) -> int:
        """Append one attribute of vertices."""
        return self.add(array.astype("<f4"), pygltflib.ARRAY_BUFFER, bounded)

    def add_texture(self, name: str, png: bytes) -> int:
        """Append a picture that repeats nowhere; returns the index of its texture."""
        document = self.document
        document.images.append(pygltflib.Image(name=name, mimeType="image/png", bufferView=self.add_view(png)))
        if not document.samplers:
            edge = pygltflib.CLAMP_TO_EDGE
            document.samplers.append(pygltflib.Sampler(wrapS=edge, wrapT=edge, magFilter=pygltflib.LINEAR))
        document.textures.append(pygltflib.Texture(sampler=0, source=len(document.images) - 1, name=name))
        return len(document.textures) - 1

    def add_node(self, node: pygltflib.Node, parent: int | None = None) -> int:
        """Append a node below another, or to the scene; returns its index."""
        self.document.nodes.append(node)
        siblings = self.document.scenes[0].nodes if parent is None else self.document.nodes[parent].children
        siblings.append(len(self.document.nodes) - 1)
        return len(self.document.nodes) - 1

    def use(self, extension: str) -> None:
        """Say that an extension is used. Programs that do not know it still open the file."""
        if extension not in self.document.extensionsUsed:
            self.document.extensionsUsed.append(extension)

    def write(self, path: Path) -> None:
        """Write the file."""
        if self._content:
            self.document.buffers = [pygltflib.Buffer(byteLength=len(self._content))]
            self.document.set_binary_blob(bytes(self._content))
        with written_whole(path) as temporary:
            temporary.write_bytes(b"".join(self.document.save_to_bytes()))
