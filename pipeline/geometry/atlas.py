"""Texture maps of a template: its own layout if usable, else a new one.

And the point under every texel centre.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float64, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from pipeline.base.errors import InputError
from pipeline.geometry.chart_packing import largest_packing
from pipeline.geometry.mesh import area_vectors
from pipeline.geometry.texels import Atlas

UV_SLACK = 1e-4
"""How far outside [0, 1] a coordinate may lie and still be clipped: 16-bit exporters round by 1.5e-5; a fifth of a
texel at size 2048."""

MAX_OVERLAP = 1e-3
"""Share of used texels that may lie inside more than one face. Each one leaves a point of the surface without its
Gaussian; 1e-3 of a map of 192 x 192 is some 20 texels, a hole that neighbours still cover. Mirrored halves have 0.5."""

MAX_FLAT_AREA = 5e-3
"""Share of the surface whose faces may have no area in the map: such faces get no Gaussian at all. Of a body's 2 square
metres this is a palm."""

EDGE_TOLERANCE = 1e-9
"""Slack of the inside test, in squared texels. Coordinates up to 8192 texels are float32 numbers held in float64: their
differences are good to 1e-12, products of two to 1e-9 at most. Two faces that share an edge then leave no gap."""

MIN_TEXEL_AREA = 1e-5
"""Twice a face's area in squared texels below which it gets no texel: its barycentrics would be worse than 1e-4."""

CANDIDATES_AT_ONCE = 4_000_000
"""(face, texel) pairs tested together: about half a gigabyte of temporaries."""


@dataclass(frozen=True)
class TexelTable:
    """The valid texels of a map in row-major order; see `pipeline.geometry.texels.Atlas`. `overlap`: share of them that
    lie inside more than one face."""

    texel: Int[np.ndarray, "t 2"]
    face: Int[np.ndarray, " t"]
    barycentric: Float64[np.ndarray, "t 3"]
    overlap: float


def uv_areas(uv: Float[np.ndarray, "f 3 2"]) -> Float64[np.ndarray, " f"]:
    """Signed area of each face in the map, float64; the sign tells mirrored faces from others."""
    a, b, c = np.moveaxis(uv.astype(np.float64), 1, 0)
    return ((b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])) / 2


def rasterize_faces(uv: Float[np.ndarray, "f 3 2"], size: int) -> TexelTable:
    """Texels whose centre lies inside a face or on its border, each with one face.

    Of a `size` x `size` map.

    Where several faces claim a centre (a shared edge, an overlap), the one of lowest index has it.
    """
    corners = uv.astype(np.float64) * size
    doubled_area = 2 * uv_areas(uv) * size**2
    # Centres lie at integer + 0.5: the first one at or above x is ceil(x - 0.5), the last at or below is floor(x -
    # 0.5).
    low = np.clip(np.ceil(corners.min(1) - 0.5 - EDGE_TOLERANCE), 0, size).astype(np.int64)
    high = np.clip(np.floor(corners.max(1) - 0.5 + EDGE_TOLERANCE) + 1, 0, size).astype(np.int64)
    box = np.maximum(high - low, 0) * (np.abs(doubled_area) > MIN_TEXEL_AREA)[:, None]
    batch = np.cumsum(box.prod(1)) // CANDIDATES_AT_ONCE
    parts = [_inside(np.flatnonzero(batch == b), corners, doubled_area, low, box, size) for b in np.unique(batch)]
    flat, face, edges = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    strictly = flat[(edges > EDGE_TOLERANCE).all(1)]
    # `face` ascends, and np.unique returns first occurrences.
    flat, first = np.unique(flat, return_index=True)
    barycentric = np.maximum(edges[first], 0)
    barycentric /= np.maximum(barycentric.sum(1, keepdims=True), MIN_TEXEL_AREA)
    shared = np.count_nonzero(np.unique(strictly, return_counts=True)[1] > 1)
    return TexelTable(np.stack([flat // size, flat % size], 1), face[first], barycentric, shared / max(len(flat), 1))


def _inside(
    faces: np.ndarray, corners: np.ndarray, doubled_area: np.ndarray, low: np.ndarray, box: np.ndarray, size: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Flat texel index, face and the three edge functions (positive inside) of every centre in one of `faces`."""
    counts = box[faces].prod(1)
    face = np.repeat(faces, counts)
    step = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    column = low[face, 0] + step % box[face, 0]
    row = low[face, 1] + step // box[face, 0]
    x, y = column + 0.5, row + 0.5
    edges = np.empty((len(face), 3))
    for i in range(3):
        start, end = corners[face, (i + 1) % 3], corners[face, (i + 2) % 3]
        edges[:, i] = (end[:, 0] - start[:, 0]) * (y - start[:, 1]) - (end[:, 1] - start[:, 1]) * (x - start[:, 0])
    edges *= np.sign(doubled_area[face])[:, None]
    inside = (edges >= -EDGE_TOLERANCE).all(1)
    return (row * size + column)[inside], face[inside], edges[inside]


def tangent_weights(uv: Float[np.ndarray, "f 3 2"]) -> Float64[np.ndarray, "f 3"]:
    """Weights w of a face's corners with dP/du parallel to sum_i w_i P_i.

    They sum to zero and their largest is 1 in size.

    From P(u, v) = linear: dP/du = (dv2 e1 - dv1 e2) / det. A face without area in the map gets its first edge.
    """
    edge1, edge2 = (uv[:, i].astype(np.float64) - uv[:, 0] for i in (1, 2))
    weights = np.stack([edge1[:, 1] - edge2[:, 1], edge2[:, 1], -edge1[:, 1]], 1) * np.sign(uv_areas(uv))[:, None]
    largest = np.abs(weights).max(1, keepdims=True)
    return np.where(largest > 0, weights / np.where(largest > 0, largest, 1), np.array([-1.0, 1.0, 0.0]))


def chart_ids(
    faces: Int[np.ndarray, "f 3"], uv: Float[np.ndarray, "f 3 2"], weld: Int[np.ndarray, " v"]
) -> Int[np.ndarray, " f"]:
    """Connected piece of the map of each face.

    Faces are joined by corners equal in space and in the map.
    """
    keys = np.concatenate([weld[faces].reshape(-1, 1), uv.reshape(-1, 2)], 1)
    count, corner = np.unique(keys, axis=0, return_inverse=True)
    corner = corner.reshape(-1, 3)
    links = np.concatenate([corner[:, :2], corner[:, 1:]])
    graph = coo_matrix((np.ones(len(links)), (links[:, 0], links[:, 1])), (len(count), len(count)))
    return connected_components(graph, directed=False)[1][corner[:, 0]]


def reasons_against(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], uv: Float[np.ndarray, "v 2"] | None, size: int
) -> list[str]:
    """Reasons for which texture coordinates per vertex cannot serve as an atlas.

    An empty list if they can.
    """
    if uv is None:
        return ["the template has no texture coordinates"]
    if not np.isfinite(uv).all():
        return ["some texture coordinates are not finite"]
    low, high = uv[faces].min(initial=0.0), uv[faces].max(initial=1.0)
    if low < -UV_SLACK or high > 1 + UV_SLACK:
        return [f"texture coordinates reach from {low:.4g} to {high:.4g}, outside [0, 1]"]
    area = np.linalg.norm(area_vectors(vertices, faces), axis=1)
    flat = area[np.abs(uv_areas(uv[faces])) * 2 * size**2 <= MIN_TEXEL_AREA].sum() / max(
        area.sum(), np.finfo(float).tiny
    )
    overlap = rasterize_faces(np.clip(uv[faces], 0, 1), size).overlap if flat < 1 else 0.0
    reasons = []
    if flat > MAX_FLAT_AREA:
        reasons.append(f"{flat:.1%} of the surface has no area in the map (at most {MAX_FLAT_AREA:.1%})")
    if overlap > MAX_OVERLAP:
        reasons.append(f"{overlap:.1%} of the texels lie inside several faces (at most {MAX_OVERLAP:.1%})")
    return reasons


def unwrap_faces(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], size: int, padding: int
) -> Float[np.ndarray, "f 3 2"]:
    """Cut and pack a new map with xatlas: coordinates per face corner. Deterministic. The charts are packed at one
    scale, the largest at which they fit a `size` x `size` map with `padding` empty texels between them; with fewer if
    not even small charts fit.

    Raises:
        InputError: if small charts do not fit without padding either, or the mesh has no area.
    """
    if not np.linalg.norm(area_vectors(vertices, faces), axis=1).sum() > 0:
        raise InputError("template.mesh: expected faces with an area, found none; check the template's scale")
    corners = largest_packing(vertices, faces, size, padding)
    if corners is None:
        raise InputError(
            f"unwrap_atlas.size: expected a map that holds the template's charts, found {size}; make it larger"
        )
    return corners


def sampled_atlas(
    vertices: Float[np.ndarray, "vertices 3"], faces: Int[np.ndarray, "faces 3"], uv: Float[np.ndarray, "faces 3 2"],
    weld: Int[np.ndarray, " vertices"], size: int,
) -> Atlas:  # fmt: skip
    """The atlas of a mesh at rest that lies in a map of `size` squared by `uv`.

    Vertices are in metres; see `Atlas`.
    """
    table = rasterize_faces(uv, size)
    chart, weights = chart_ids(faces, uv, weld), tangent_weights(uv)
    return Atlas(
        size, faces.astype(np.int32), uv, weld.astype(np.int32), vertices.astype(np.float32),
        table.texel.astype(np.int32), table.face.astype(np.int32), table.barycentric.astype(np.float32),
        chart[table.face].astype(np.int32), weights[table.face].astype(np.float32),
    )  # fmt: skip
