"""Triangle meshes: welding across texture seams, area vectors, smooth vertex normals. NumPy and torch alike."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from pipeline.base.array_module import Array, array_module, is_tensor

WELD_TOLERANCE = 1e-6
"""Distance, relative to the mesh's extent, below which two vertices are one. float32 coordinates are good to 6e-8 of
the extent and a skin's float32 weights add a few times that; modelled detail starts at 1e-4 (0.2 mm on a body)."""

BACK_TO_BACK = -0.9
"""Cosine between the normals of two vertices in one place below which they are not welded: the two sides of a sheet
modelled twice (hair, cloth) point away from each other, and their average would be no normal at all."""


def unit_or(vectors: Array, fallback: Array | float) -> Array:
    """Vectors [..., 3] at unit length; those of exactly zero length become `fallback`.

    The largest component is divided out first, so that squares neither overflow nor underflow at any scene scale.
    """
    xp = array_module(vectors)
    largest = xp.amax(xp.abs(vectors), -1)[..., None]
    empty = largest == 0
    scaled = vectors / xp.where(empty, xp.ones_like(largest), largest)
    # Under the root, or its slope at zero would make the gradient NaN, chosen or not.
    squared = xp.where(empty, xp.ones_like(largest), (scaled * scaled).sum(-1)[..., None])
    return xp.where(empty, fallback, scaled / xp.sqrt(squared))


def area_vectors(vertices: Float[Array, "*b v 3"], faces: Int[Array, "f 3"]) -> Float[Array, "*b f 3"]:
    """Outward normal of each face times its area.

    Corners are counter-clockwise; zero for a degenerate face.
    """
    a, b, c = (vertices[..., faces[:, i], :] for i in range(3))
    return array_module(vertices).linalg.cross(b - a, c - a) / 2


def vertex_normals(
    vertices: Float[Array, "*b v 3"],
    faces: Int[Array, "f 3"],
    weld: Int[Array, " v"],
) -> Float[Array, "*b v 3"]:
    """Smooth unit normals of vertices.

    The area-weighted mean over the faces around a vertex and around all vertices welded to it.

    Degenerate faces have no area and contribute nothing. A vertex whose faces have none, or cancel exactly, gets zero.

    Args:
        vertices: posed positions, any unit.
        faces: corner indices.
        weld: per vertex, the vertex that stands for all in its place (`weld_vertices`).
    """
    per_face = area_vectors(vertices, faces)
    corner_weld = weld[faces]
    sums = vertices * 0
    for corner in range(3):
        sums = _add_rows(sums, corner_weld[:, corner], per_face)
    return unit_or(sums[..., weld, :], 0.0)


def _add_rows(sums: Array, rows: Array, values: Array) -> Array:
    """`sums` [..., v, 3] with `values` [..., f, 3] added to rows `rows` [f]; a row may occur many times."""
    if is_tensor(sums):
        return sums.index_add(-2, rows, values)
    flat = values.reshape(-1, *values.shape[-2:])
    count = sums.shape[-2]
    added = [[np.bincount(rows, one[:, axis], count) for axis in range(3)] for one in flat]
    return sums + np.moveaxis(np.array(added), 1, 2).reshape(sums.shape).astype(sums.dtype)


def weld_vertices(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, " v"]:
    """Lowest index among the vertices in the same place, per vertex.

    Within `WELD_TOLERANCE`, itself included.

    Exporters repeat a vertex along every texture seam; normals and charts must not see those seams. Vertices whose own
    faces look in opposite directions (`BACK_TO_BACK`) stay apart. Use rest positions: in motion, surfaces touch.
    """
    from scipy.sparse import coo_matrix  # Here, as most stages that read meshes do without: it takes long to import.
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    extent = float(np.ptp(vertices, axis=0).max()) if len(vertices) else 0.0
    pairs = cKDTree(vertices).query_pairs(WELD_TOLERANCE * extent, output_type="ndarray")
    own = vertex_normals(np.asarray(vertices, np.float64), faces, np.arange(len(vertices)))
    pairs = pairs[(own[pairs[:, 0]] * own[pairs[:, 1]]).sum(1) > BACK_TO_BACK]
    shape = (len(vertices), len(vertices))
    count, group = connected_components(
        coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape), directed=False
    )
    lowest = np.full(count, len(vertices))
    np.minimum.at(lowest, group, np.arange(len(vertices)))
    return lowest[group]


def is_closed(faces: Int[np.ndarray, "f 3"], weld: Int[np.ndarray, " v"]) -> bool:
    """True if two faces share every edge of the welded mesh, in opposite directions."""
    welded = weld[faces]
    ahead = np.concatenate([welded[:, [0, 1]], welded[:, [1, 2]], welded[:, [2, 0]]])
    ahead = ahead[ahead[:, 0] != ahead[:, 1]]
    there, there_count = np.unique(ahead, axis=0, return_counts=True)
    back, back_count = np.unique(ahead[:, ::-1], axis=0, return_counts=True)
    return len(there) == len(back) and bool((there == back).all() and (there_count == back_count).all())


def signed_volume(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> float:
    """Volume inside a closed mesh; negative if its faces look inwards. Meaningless for an open mesh."""
    centred = np.asarray(vertices, np.float64) - vertices.mean(0)
    return float((centred[faces[:, 0]] * area_vectors(centred, faces)).sum() / 3)
