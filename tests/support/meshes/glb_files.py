"""Small .glb files written byte by byte after the glTF 2.0 specification.

None of the pipeline's libraries is used.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np

COMPONENTS = {"int8": 5120, "uint8": 5121, "int16": 5122, "uint16": 5123, "uint32": 5125, "float32": 5126}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class GlbFile:
    """Collects accessors and JSON objects; `write` makes the file."""

    def __init__(self) -> None:
        self.binary = b""
        self.views: list[dict] = []
        self.content: dict = {"asset": {"version": "2.0"}, "accessors": [], "meshes": [], "nodes": [], "skins": []}

    def view(self, data: bytes, stride: int | None = None) -> int:
        """A buffer view of `data`; returns its index."""
        self.binary += b"\0" * (-len(self.binary) % 4)
        view = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data)}
        self.views.append(view | ({"byteStride": stride} if stride else {}))
        self.binary += data
        return len(self.views) - 1

    def accessor(self, values: np.ndarray, *, normalized: bool = False, pad: int = 0) -> int:
        """Add an accessor of [count, components] values with `pad` unused bytes after each element."""
        rows = values.reshape(len(values), -1)
        data = b"".join(row.tobytes() + b"\xff" * pad for row in rows)
        stride = rows.dtype.itemsize * rows.shape[1] + pad if pad else None
        self.content["accessors"].append(
            {
                "bufferView": self.view(data, stride),
                "componentType": COMPONENTS[rows.dtype.name],
                "count": len(rows),
                "type": TYPES[rows.shape[1]],
                "normalized": normalized,
            }
        )
        return len(self.content["accessors"]) - 1

    def write(self, path: Path) -> Path:
        """Write header, JSON chunk and binary chunk."""
        content = {key: value for key, value in self.content.items() if value != []}
        content |= {"bufferViews": self.views, "buffers": [{"byteLength": len(self.binary)}]}
        text = json.dumps(content).encode()
        text += b" " * (-len(text) % 4)
        binary = self.binary + b"\0" * (-len(self.binary) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
        return path
