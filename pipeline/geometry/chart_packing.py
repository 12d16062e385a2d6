"""Chart cutting and packing by xatlas, in a watched child process.

xatlas can hang when it ends its threads.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, Int, UInt32

from pipeline.base.errors import InputError
from pipeline.base.watched_child import ChildFailed, run_watched
from pipeline.geometry import xatlas_child
from pipeline.geometry.mesh import area_vectors


@dataclass(frozen=True)
class CutMesh:
    """A mesh cut along texture seams.

    Attributes:
        source: for each vertex, the vertex of the uncut mesh it is a copy of.
        faces: triangles in the order of the uncut mesh.
        uv: texture coordinates in [0, 1].
    """

    source: UInt32[np.ndarray, " u"]
    faces: UInt32[np.ndarray, "f 3"]
    uv: Float32[np.ndarray, "u 2"]


def largest_packing(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], size: int, padding: int
) -> Float32[np.ndarray, "f 3 2"] | None:
    """Texture coordinates per face corner of the packing of largest scale.

    See `xatlas_child.largest_packing`.
    """
    area = np.linalg.norm(area_vectors(vertices, faces), axis=1).sum()
    return _run(vertices, faces, size=size, padding=padding, search=True, high=size / np.sqrt(area)).get("uv")


def cut_and_pack(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], size: int, padding: int, iterations: int
) -> CutMesh:
    """Cut a mesh into charts and pack them once, at the scale that xatlas estimates.

    Args:
        vertices: positions.
        faces: triangles.
        size: side of the map in texels.
        padding: empty texels between charts.
        iterations: how often charts are grown anew from their middles.
    """
    return CutMesh(**_run(vertices, faces, size=size, padding=padding, search=False, iterations=iterations))


def _run(vertices: np.ndarray, faces: np.ndarray, **numbers: Any) -> dict[str, np.ndarray]:
    """Run the child on a mesh and read its result.

    Raises:
        InputError: if xatlas cannot unwrap it, or stands still again and again.
    """
    with tempfile.TemporaryDirectory(prefix="chart_packing_") as folder:
        job, result = Path(folder, "job.npz"), Path(folder, "result.npz")
        np.savez(job, vertices=vertices.astype(np.float32), faces=faces.astype(np.uint32), **numbers)
        try:
            run_watched([sys.executable, xatlas_child.__file__, str(job), str(result)])
        except ChildFailed as failure:
            raise InputError(f"template.mesh: expected a mesh that xatlas can unwrap, found: {failure}") from failure
        with np.load(result, allow_pickle=False) as arrays:
            return dict(arrays)
