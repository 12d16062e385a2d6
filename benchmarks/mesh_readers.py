"""Our readers of meshes beside trimesh's, on a grid whose texture has a seam in every row of faces."""

from __future__ import annotations

import io
import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from pipeline.geometry.gltf import GltfFile
from pipeline.geometry.mesh_files import decode_mesh

SIDE = 100
"""Vertices along a side of the grid."""


@dataclass(frozen=True)
class Reading:
    """One reader on one kind of file: vertices of the file, vertices read, whether they are in order, milliseconds."""

    kind: str
    reader: str
    vertices: int
    found: int
    in_order: bool
    milliseconds: float


def grid() -> tuple[np.ndarray, np.ndarray]:
    """Vertices [10000, 3] and triangles."""
    rows, columns = np.mgrid[:SIDE, :SIDE]
    height = 0.1 * np.sin(rows / 7.0) * np.cos(columns / 5.0)
    vertices = np.stack([columns / SIDE, rows / SIDE, height], -1).reshape(-1, 3)
    corner = (rows * SIDE + columns)[:-1, :-1].ravel()
    faces = np.concatenate([
        np.stack([corner, corner + 1, corner + SIDE], -1), np.stack([corner + 1, corner + SIDE + 1, corner + SIDE], -1)
    ])  # fmt: skip
    return vertices, faces


def seamed_obj(vertices: np.ndarray, faces: np.ndarray) -> bytes:
    """An OBJ whose every triangle has texture coordinates of its own, as an atlas of triangles has."""
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices]
    lines += [f"vt {i % 97 / 97:.6f} {i % 89 / 89:.6f}" for i in range(3 * len(faces))]
    lines += [
        "f " + " ".join(f"{v + 1}/{3 * number + c + 1}" for c, v in enumerate(face))
        for number, face in enumerate(faces.tolist())
    ]
    return "\n".join(lines).encode()


def two_materials(vertices: np.ndarray, faces: np.ndarray) -> bytes:
    """An OBJ whose faces are of two materials, as skin and eyes are."""
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices]
    half = len(faces) // 2
    for name, some in (("skin", faces[half:]), ("eyes", faces[:half])):
        lines += [f"usemtl {name}", *(f"f {a} {b} {c}" for a, b, c in (some + 1).tolist())]
    return "\n".join(lines).encode()


def textured_in_part(vertices: np.ndarray, faces: np.ndarray) -> bytes:
    """An OBJ of two textured faces with a seam between them, whose other vertices no face has: landmarks, say."""
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices]
    lines += ["vt 0 0", "vt 1 0", "vt 0 1"]
    (a, b, c), (d, e, f) = (faces[:2] + 1).tolist()
    lines += [f"f {a}/1 {b}/2 {c}/3", f"f {d}/3 {e}/1 {f}/2"]  # They share a vertex.
    return "\n".join(lines).encode()


def compare_readers(repeats: int) -> list[Reading]:
    """A row for each kind of file and reader."""
    vertices, faces = grid()
    mesh = trimesh.Trimesh(vertices, faces, process=False, validate=False)
    obj, ply, glb = seamed_obj(vertices, faces), mesh.export(file_type="ply"), mesh.export(file_type="glb")
    materials, part = two_materials(vertices, faces), textured_in_part(vertices, faces)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "grid.glb"
        path.write_bytes(glb)
        readers: list[tuple[str, str, Callable[[], np.ndarray]]] = [
            (".obj with seams", "ours", lambda: decode_mesh(obj, Path("grid.obj")).vertices),
            (".obj with seams", "trimesh", lambda: _loaded(obj, "obj")),
            (".obj of two materials", "ours", lambda: decode_mesh(materials, Path("grid.obj")).vertices),
            (".obj of two materials", "trimesh", lambda: _loaded(materials, "obj")),
            (".obj, textured in part", "ours", lambda: decode_mesh(part, Path("grid.obj")).vertices),
            (".obj, textured in part", "trimesh", lambda: _loaded(part, "obj")),
            (".ply", "ours, by trimesh's", lambda: decode_mesh(ply, Path("grid.ply")).vertices),
            (".ply", "trimesh", lambda: _loaded(ply, "ply")),
            (".glb", "ours", lambda: np.concatenate([part.positions for part in GltfFile(path).primitives()])),
            (".glb", "trimesh", lambda: _loaded(glb, "glb")),
        ]
        return [_timed(kind, reader, read, vertices, repeats) for kind, reader, read in readers]


def _loaded(content: bytes, kind: str) -> np.ndarray:
    """Vertices as trimesh reads them, told to change nothing."""
    return trimesh.load_mesh(io.BytesIO(content), file_type=kind, process=False, maintain_order=True).vertices


def _timed(kind: str, reader: str, read: Callable[[], np.ndarray], vertices: np.ndarray, repeats: int) -> Reading:
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        found = np.asarray(read())
        times.append(time.perf_counter() - began)
    in_order = found.shape == vertices.shape and bool(np.allclose(found, vertices, atol=1e-6))
    row = Reading(kind, reader, len(vertices), len(found), in_order, 1e3 * statistics.median(times))
    print(row, flush=True)
    return row
