"""From solids to one closed triangle mesh, by naive surface nets.

The surface is that of a smooth union of round cones. Surface nets: Gibson, "Constrained Elastic Surface Nets", MICCAI
1998. One vertex per grid cell that the surface crosses, one quad per grid edge that it crosses; vertices are then
pulled onto the surface and evened out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import scipy.sparse
from jaxtyping import Float64, Int64

from pipeline.synthesis.skeleton import RoundCone

BLEND_M = 0.02
"""Width of the fillet between two solids. About a vertex spacing, so that the mesh can show it."""

GRADIENT_STEP_M = 1e-5
"""Central-difference step. Distances of order 1 m in float64 lose 1e-16 / 1e-5 = 1e-11, far below mesh accuracy."""

RELAX_ROUNDS = 12
"""Rounds of evening out; triangles stop improving visibly after about ten."""


def distance_to_solids(points: Float64[np.ndarray, "n 3"], solids: Sequence[RoundCone]) -> Float64[np.ndarray, "n s"]:
    """Approximate signed distance of each point to each solid, negative inside.

    The radius is interpolated at the nearest point of the axis, which is exact on the axis and for capsules; the
    zero set is what matters, and it is smooth.
    """
    distances = []
    for solid in solids:
        squeeze = np.array([1.0, 1.0, 1.0 / solid.flatten])
        start, end = np.array(solid.start) * squeeze, np.array(solid.end) * squeeze
        axis, offset = end - start, points * squeeze - start
        along = np.clip(offset @ axis / (axis @ axis), 0.0, 1.0)
        radius = solid.start_radius + along * (solid.end_radius - solid.start_radius)
        distances.append(np.linalg.norm(offset - along[:, None] * axis, axis=1) - radius)
    return np.stack(distances, axis=1)


def smooth_union(points: Float64[np.ndarray, "n 3"], solids: Sequence[RoundCone]) -> Float64[np.ndarray, " n"]:
    """Distance-like field of the union, fillets of width `BLEND_M`."""
    return smooth_minimum(distance_to_solids(points, solids), BLEND_M)


def smooth_minimum(distances: Float64[np.ndarray, "n s"], blend_m: float) -> Float64[np.ndarray, " n"]:
    """Field of a union, -b log sum exp(-d / b) over the solids' distances d, with b = `blend_m`.

    Fillets between two solids are about as wide as `blend_m`.
    """
    scaled = -distances / blend_m
    largest = scaled.max(axis=1, keepdims=True)
    return -blend_m * (largest[:, 0] + np.log(np.exp(scaled - largest).sum(axis=1)))


def surface_nets(
    field: Callable[[np.ndarray], np.ndarray],
    low: Float64[np.ndarray, "3"],
    high: Float64[np.ndarray, "3"],
    spacing: float,
) -> tuple[Float64[np.ndarray, "v 3"], Int64[np.ndarray, "f 3"]]:
    """Mesh the zero set of `field` inside the box `low`..`high`.

    The box must contain the whole surface; `spacing` is the grid's and so about the mesh's edge length. Returns
    vertices and outward-facing triangles.
    """
    counts = np.ceil((high - low) / spacing).astype(np.int64) + 1
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in counts), indexing="ij"), axis=-1)
    values = field((low + spacing * grid).reshape(-1, 3)).reshape(counts)
    crossing_sum = np.zeros((*(counts - 1), 3))
    crossing_count = np.zeros(counts - 1)
    for axis, start in _CELL_EDGES:
        near, far = _cell_corner(values, start), _cell_corner(values, start + np.eye(3, dtype=np.int64)[axis])
        crossed = (near < 0) != (far < 0)
        along = np.where(crossed, near / np.where(crossed, near - far, 1.0), 0.0)
        crossing_sum += crossed[..., None] * (start + along[..., None] * np.eye(3)[axis])
        crossing_count += crossed
    cells = np.argwhere(crossing_count > 0)
    inside_cell = crossing_sum[tuple(cells.T)] / crossing_count[tuple(cells.T)][:, None]
    vertices = low + spacing * (cells + inside_cell)
    vertex_of_cell = np.full(counts - 1, -1, dtype=np.int64)
    vertex_of_cell[tuple(cells.T)] = np.arange(len(cells))
    quads = np.concatenate([_quads_around_edges(values, vertex_of_cell, axis) for axis in range(3)])
    return vertices, _split_quads(vertices, quads)


_CELL_EDGES = [
    (axis, np.insert(np.array([b, c], dtype=np.int64), axis, 0)) for axis in range(3) for b in (0, 1) for c in (0, 1)
]
"""The 12 edges of a grid cell: axis and first corner."""


def _cell_corner(values: np.ndarray, corner: np.ndarray) -> np.ndarray:
    """The value at one corner of every cell."""
    return values[tuple(slice(c, n - 1 + c) for c, n in zip(corner, values.shape, strict=True))]


def _quads_around_edges(values: np.ndarray, vertex_of_cell: np.ndarray, axis: int) -> np.ndarray:
    """One quad per grid edge along `axis` that the surface crosses.

    Its corners are the vertices of the four cells around the edge.
    """
    inside = values < 0
    near, far = np.moveaxis(inside, axis, 0)[:-1], np.moveaxis(inside, axis, 0)[1:]
    crossed = np.argwhere(np.moveaxis(near != far, 0, axis))
    step_b, step_c = np.eye(3, dtype=np.int64)[(axis + 1) % 3], np.eye(3, dtype=np.int64)[(axis + 2) % 3]
    around = [crossed, crossed - step_b, crossed - step_b - step_c, crossed - step_c]
    quads = np.stack([vertex_of_cell[tuple(cell.T)] for cell in around], axis=1)
    outward = inside[tuple(crossed.T)]
    return np.where(outward[:, None], quads, quads[:, ::-1])


def _split_quads(vertices: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """Two triangles per quad, cut along the shorter diagonal."""
    corners = vertices[quads]
    diagonal_02 = np.linalg.norm(corners[:, 0] - corners[:, 2], axis=1)
    diagonal_13 = np.linalg.norm(corners[:, 1] - corners[:, 3], axis=1)
    along_02 = quads[:, [0, 1, 2, 0, 2, 3]]
    along_13 = quads[:, [0, 1, 3, 1, 2, 3]]
    return np.where((diagonal_02 <= diagonal_13)[:, None], along_02, along_13).reshape(-1, 3)


def neighbor_average(faces: Int64[np.ndarray, "f 3"], vertex_count: int) -> scipy.sparse.csr_matrix:
    """Sparse matrix that replaces each vertex's value by the mean of its neighbours'."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    both = np.unique(np.concatenate([edges, edges[:, ::-1]]), axis=0)
    ones = np.ones(len(both))
    adjacency = scipy.sparse.csr_matrix((ones, (both[:, 0], both[:, 1])), shape=(vertex_count, vertex_count))
    return scipy.sparse.diags(1.0 / np.maximum(np.asarray(adjacency.sum(axis=1))[:, 0], 1.0)) @ adjacency


def even_out(
    vertices: Float64[np.ndarray, "v 3"],
    faces: Int64[np.ndarray, "f 3"],
    field: Callable[[np.ndarray], np.ndarray],
) -> Float64[np.ndarray, "v 3"]:
    """Even out a mesh on the zero set of a field.

    Vertices move to the mean of their neighbours, then back onto the zero set by Newton steps, a few times.
    """
    average = neighbor_average(faces, len(vertices))
    for _ in range(RELAX_ROUNDS):
        vertices = 0.5 * (vertices + average @ vertices)
        for _ in range(2):
            gradient = field_gradient(vertices, field)
            step = field(vertices) / np.maximum((gradient**2).sum(axis=1), 1e-6)
            vertices = vertices - step[:, None] * gradient
    return vertices


def field_gradient(points: np.ndarray, field: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Central differences of `field` at points [n, 3]."""
    steps = GRADIENT_STEP_M * np.eye(3)
    return np.stack([(field(points + h) - field(points - h)) / (2 * GRADIENT_STEP_M) for h in steps], axis=1)
