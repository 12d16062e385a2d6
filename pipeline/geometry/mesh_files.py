"""Meshes in files of other programs, .ply and .obj: vertices in their order, triangles."""

from __future__ import annotations

import io
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64

from pipeline.base.errors import InputError

SUFFIXES = (".ply", ".obj")


@dataclass(frozen=True)
class Mesh:
    """Vertices in the order and the unit of the file, and triangles, if it lists faces."""

    vertices: Float64[np.ndarray, "vertices 3"]
    faces: Int64[np.ndarray, "faces 3"]


def decode_mesh(content: bytes, path: Path) -> Mesh:
    """A mesh from its file's bytes; `path` says the format and names it in messages.

    Polygons become fans of triangles. Nothing is merged or reordered, so that vertices of several files correspond.

    Raises:
        InputError: if the file cannot be read, or has no vertex or one that is not finite.
    """
    suffix = Path(path).suffix.lower()
    try:
        mesh = _decode_obj(content) if suffix == ".obj" else _decode_ply(content)
    except (ValueError, LookupError, TypeError, UnicodeDecodeError, AttributeError) as error:
        raise InputError(f"{path}: expected a {suffix} mesh, found one that does not decode: {error}") from error
    if not len(mesh.vertices) or not np.isfinite(mesh.vertices).all():
        raise InputError(f"{path}: expected vertices of finite coordinates, found {len(mesh.vertices)} vertices")
    if len(mesh.faces) and not 0 <= mesh.faces.min() <= mesh.faces.max() < len(mesh.vertices):
        found = f"{mesh.faces.min()} to {mesh.faces.max()}"
        raise InputError(f"{path}: faces: expected vertices 0 to {len(mesh.vertices) - 1}, found {found}")
    return mesh


def _decode_ply(content: bytes) -> Mesh:
    import trimesh  # A third of a second to import; stages without meshes of others do without it.

    fields = trimesh.exchange.ply.load_ply(io.BytesIO(content), fix_texture=False, prefer_color=None)
    faces = fields.get("faces")
    faces = np.zeros((0, 3), np.int64) if faces is None else np.asarray(faces, np.int64).reshape(-1, 3)
    return Mesh(np.asarray(fields["vertices"], np.float64).reshape(-1, 3), faces)


def _decode_obj(content: bytes) -> Mesh:
    """Positions and faces alone: readers that split vertices at seams of the texture would change their numbers."""
    vertices, faces = [], []
    for line in content.decode().splitlines():
        kind, *words = line.split() or [""]
        if kind == "v":
            vertices.append([float(word) for word in words[:3]])
        elif kind == "f":
            corners = [int(word.split("/")[0]) for word in words]
            corners = [corner - 1 if corner > 0 else len(vertices) + corner for corner in corners]
            faces += [[corners[0], *pair] for pair in pairwise(corners[1:])]
    return Mesh(np.array(vertices, np.float64).reshape(-1, 3), np.array(faces, np.int64).reshape(-1, 3))
