"""xatlas in a process of its own, which leaves without running destructors.

When an atlas is destroyed, xatlas ends its worker threads, and now and then one misses its wake-up: the destructor of
the task scheduler then waits for it for ever (`xatlas::internal::TaskScheduler::~TaskScheduler` sets `wakeup` without
holding the mutex that the worker's wait goes by). So no atlas is ever destroyed here: each is kept until the process
ends by `os._exit`. Run as a script: `xatlas_child.py JOB.npz RESULT.npz`.
"""

from __future__ import annotations

import os
import sys
from typing import Any

import numpy as np
import xatlas

KEPT: list[xatlas.Atlas] = []
"""Every atlas of this process: what is kept is not destroyed."""

PACKING_STEPS = 7
"""Halvings of the bracket around the best scale of a packing: a factor of 8 shrinks to 8 ** (1 / 2**7), 1.6 %. Each
cuts all charts anew, as xatlas stretches charts to whole texels when it cuts them; packed at another scale they would
fill less."""


def generate(vertices: np.ndarray, faces: np.ndarray, charts: dict[str, Any], packing: dict[str, Any]) -> xatlas.Atlas:
    """Cut and pack a mesh.

    Args:
        vertices: [v, 3] float32.
        faces: [f, 3] uint32.
        charts: attributes of `xatlas.ChartOptions`, as far as they differ from its defaults.
        packing: attributes of `xatlas.PackOptions`, likewise.
    """
    options = xatlas.ChartOptions(), xatlas.PackOptions()
    for option, changes in zip(options, (charts, packing), strict=True):
        for name, value in changes.items():
            setattr(option, name, value)
    atlas = xatlas.Atlas()
    KEPT.append(atlas)
    atlas.add_mesh(vertices, faces)
    atlas.generate(*options)
    return atlas


def largest_packing(vertices: np.ndarray, faces: np.ndarray, size: int, padding: int, high: float) -> np.ndarray | None:
    """Texture coordinates [f, 3, 2] of the packing of largest scale that fits, or None.

    float32, in a map of `size` x `size` texels.

    The scale, in texels per metre, is the same for all charts. With fewer than `padding` texels between charts if not
    even small ones fit. `high` is the scale at which the mesh would fill the whole map: no packing does, and xatlas
    fills far more than 1/64 of it.
    """
    low = high / 8
    for gap in range(padding, -1, -1):
        best = _packing(vertices, faces, size, gap, low)
        if best is not None:
            break
    else:
        return None
    for _ in range(PACKING_STEPS):
        middle = np.sqrt(low * high)
        packed = _packing(vertices, faces, size, gap, middle)
        best, low, high = (packed, middle, high) if packed is not None else (best, low, middle)
    return best


def _packing(vertices: np.ndarray, faces: np.ndarray, size: int, padding: int, scale: float) -> np.ndarray | None:
    """Coordinates per face corner at `scale` texels per metre, or None if they need more than one map."""
    options = {"resolution": size, "padding": padding, "texels_per_unit": scale, "bruteForce": True}
    cut = generate(vertices, faces, {}, options)
    if cut.atlas_count != 1 or max(cut.width, cut.height) > size:
        return None
    vertex, indices, uv = cut[0]
    if len(indices) != len(faces) or (vertex[indices] != faces).any():
        raise AssertionError("xatlas is expected to keep the order of faces and corners")
    return (uv * np.array([cut.width, cut.height], np.float32) / np.float32(size))[indices]


def main() -> None:
    """Do the job of one file and leave."""
    job = dict(np.load(sys.argv[1], allow_pickle=False))
    vertices, faces, size, padding = job["vertices"], job["faces"], int(job["size"]), int(job["padding"])
    if job["search"]:
        corners = largest_packing(vertices, faces, size, padding, float(job["high"]))
        result = {} if corners is None else {"uv": corners}
    else:
        packing = {"resolution": size, "padding": padding, "bilinear": True}
        source, cut, uv = generate(vertices, faces, {"max_iterations": int(job["iterations"])}, packing)[0]
        result = {"source": source, "faces": cut, "uv": uv}
    with open(sys.argv[2], "wb") as file:
        np.savez(file, **result)
    sys.stderr.flush()
    os._exit(0)


if __name__ == "__main__":
    main()
