"""xatlas in a process of its own, which leaves without running destructors.

When an atlas is destroyed, xatlas ends its worker threads, and now and then one misses its wake-up: the destructor of
the task scheduler then waits for it for ever (`xatlas::internal::TaskScheduler::~TaskScheduler` sets `wakeup` without
holding the mutex that the worker's wait goes by). So no atlas is ever destroyed here: each is kept until the process
ends by `os._exit`. Run as a script: `xatlas_child.py JOB.npz RESULT.npz`.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from typing import Any

import numpy as np
import xatlas

KEPT: list[xatlas.Atlas] = []
"""Every atlas of this process: what is kept is not destroyed."""

FLAT_SIZE = 4096
"""Texels per side of a map that would hold the charts when they are cut. xatlas stretches each to whole texels: of
these, far below one of the map's."""

PACKING_STEPS = 12
"""Halvings of the bracket around the best scale of a packing: a factor of 8 shrinks to 8 ** (1 / 2**12), below a
texel."""


def generate(vertices: np.ndarray, faces: np.ndarray, charts: dict[str, Any], packing: dict[str, Any]) -> xatlas.Atlas:
    """Cut and pack a mesh.

    Args:
        vertices: [v, 3] float32.
        faces: [f, 3] uint32.
        charts: attributes of `xatlas.ChartOptions`, as far as they differ from its defaults.
        packing: attributes of `xatlas.PackOptions`, likewise.
    """
    atlas = xatlas.Atlas()
    KEPT.append(atlas)
    atlas.add_mesh(vertices, faces)
    atlas.generate(_with(xatlas.ChartOptions(), charts), _with(xatlas.PackOptions(), packing))
    return atlas


def _with(options: Any, changes: dict[str, Any]) -> Any:
    for name, value in changes.items():
        setattr(options, name, value)
    return options


def largest_packing(vertices: np.ndarray, faces: np.ndarray, size: int, padding: int, high: float) -> np.ndarray | None:
    """Texture coordinates [f, 3, 2] of the packing of largest scale that fits, or None.

    float32, in a map of `size` x `size` texels.

    The scale, in texels per metre, is the same for all charts. With fewer than `padding` texels between charts if not
    even small ones fit. `high` is the scale at which the mesh would fill the whole map: no packing does, and xatlas
    fills far more than 1/64 of it.
    """
    charts, low = _flat_charts(vertices, faces, high * FLAT_SIZE / size), high / 8
    for gap in range(padding, -1, -1):
        best = _packing(charts, size, gap, low)
        if best is not None:
            break
    else:
        return None
    for _ in range(PACKING_STEPS):
        middle = np.sqrt(low * high)
        packed = _packing(charts, size, gap, middle)
        best, low, high = (packed, middle, high) if packed is not None else (best, low, middle)
    return best


@dataclass(frozen=True)
class FlatCharts:
    """Charts laid flat beside each other.

    Attributes:
        corners: [u, 2] float32, metres.
        faces: [f, 3] uint32, rows of them.
    """

    corners: np.ndarray
    faces: np.ndarray


def _flat_charts(vertices: np.ndarray, faces: np.ndarray, scale: float) -> FlatCharts:
    """Cut charts once, for packings of any scale; `scale`, texels per metre, says how finely they are laid out."""
    cut = generate(vertices, faces, {}, {"texels_per_unit": scale})
    vertex, indices, uv = cut[0]
    _check_order(vertex[indices], faces)
    return FlatCharts(uv * np.array([cut.width, cut.height], np.float32) / np.float32(cut.texels_per_unit), indices)


def _packing(charts: FlatCharts, size: int, padding: int, scale: float) -> np.ndarray | None:
    """Coordinates per face corner at `scale` texels per metre, or None if they need more than one map."""
    packed = xatlas.Atlas()
    KEPT.append(packed)
    packed.add_uv_mesh(charts.corners, charts.faces)
    options = {"resolution": size, "padding": padding, "texels_per_unit": scale, "bruteForce": True}
    packed.generate(xatlas.ChartOptions(), _with(xatlas.PackOptions(), options))
    if packed.atlas_count != 1 or max(packed.width, packed.height) > size:
        return None
    vertex, indices, uv = packed[0]
    _check_order(vertex[indices], charts.faces)
    return (uv * np.array([packed.width, packed.height], np.float32) / np.float32(size))[indices]


def _check_order(found: np.ndarray, given: np.ndarray) -> None:
    if found.shape != given.shape or (found != given).any():
        raise AssertionError("xatlas is expected to keep the order of faces and corners")


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
