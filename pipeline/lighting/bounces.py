"""Light that reaches a texel by way of another: one traced bounce over the atlas.

The irradiance from other surfaces is the integral of their radiance L times the cosine; with directions drawn in
proportion to the cosine it is pi times the mean of L over the rays, nothing counted for rays that leave the scene:

    E(v) = pi / n sum_k L(texel hit by ray k)

Which texel a ray hits depends on the pose alone. Traced once per pose, a bounce is a sum over a table: of any light,
and of colours that are still being learned. The mesh occludes from both sides, but only its outside shines.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, Float64, Int, Int32
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from pipeline.geometry.texels import Atlas
from pipeline.lighting.draw_kernels import PLASTIC
from pipeline.lighting.visibility import Occluders

GOLDEN = (1 + 5**0.5) / 2


def cosine_directions(count: int, points: int) -> Float64[np.ndarray, "points count 3"]:
    """Unit directions about +z with density cosine / pi.

    A Fibonacci spiral on the disc, raised to the hemisphere (Malley's method; Pharr et al., Physically Based
    Rendering, 13.6.3). Every point has it turned about z and shifted along its arm. Turns and shifts of neighbouring
    points are far apart, so that their errors average out in a picture.
    """
    shift, turned = (0.5 + np.arange(points)[:, None] / np.array([PLASTIC, PLASTIC**2])[:, None, None]) % 1
    squared_radius = (np.arange(count) + shift) / count
    turn, across = 2 * np.pi * (np.arange(count) / GOLDEN**2 + turned), np.sqrt(squared_radius)
    return np.stack([across * np.cos(turn), across * np.sin(turn), np.sqrt(1 - squared_radius)], -1)


@lru_cache(maxsize=1)
def spread_directions(count: int, points: int) -> Float32[np.ndarray, "points count 3"]:
    """`cosine_directions` in single precision, as Embree takes rays.

    Kept, for all frames have the same; read-only.
    """
    directions = cosine_directions(count, points).astype(np.float32)
    directions.flags.writeable = False
    return directions


def trace_bounces(
    atlas: Atlas,
    occluders: Occluders,
    points: Float[np.ndarray, "t 3"],
    frames: Float[np.ndarray, "t 3 3"],
    face_normals: Float[np.ndarray, "f 3"],
    count: int,
    some: Bool[np.ndarray, " t"] | None = None,
) -> Int32[np.ndarray, "t {count}"]:
    """Trace the texel that each of `count` rays from each texel hits.

    With t texels it is t, one past the last, where a ray hits none.

    Args:
        atlas: NumPy.
        occluders: the posed mesh.
        points, frames: posed texels; rays are spread by the cosine with the third column.
        face_normals: outward unit normals of all faces.
        some: texels that send rays; the others hit none. All if not given.
    """
    texels, sending = len(points), slice(None) if some is None else some
    turned = frames[sending].astype(np.float32).swapaxes(1, 2)
    directions = (spread_directions(count, texels)[sending] @ turned).reshape(-1, 3)
    above = np.repeat(face_normals[atlas.face[sending]].astype(np.float32), count, 0)
    hit = np.full(len(directions), texels, np.int32)
    face, barycentric = occluders.first_faces(np.repeat(points[sending], count, 0), above, directions)
    rows = np.flatnonzero(face >= 0)
    face, barycentric = face[rows], barycentric[rows]
    outside = np.einsum("nd,nd->n", face_normals[face], directions[rows]) < 0
    uv = (atlas.uv[face] * barycentric[..., None]).sum(1)
    column, row = np.clip((uv * atlas.size).astype(np.int64), 0, atlas.size - 1).T
    hit[rows[outside]] = nearest_texels(atlas)[row, column][outside]
    if some is None:
        return hit.reshape(texels, count)
    hits = np.full((texels, count), texels, np.int32)
    hits[some] = hit.reshape(-1, count)
    return hits


def nearest_texels(atlas: Atlas) -> Int[np.ndarray, "size size"]:
    """Index of the texel at each place of the map; where there is none, of the nearest."""
    index = atlas.to_map(np.arange(atlas.texel_count), outside=-1.0)
    row, column = distance_transform_edt(index < 0, return_distances=False, return_indices=True)
    return index[row, column]


def bounced_irradiance(
    radiance: Float[Tensor, "t channels"], hits: Int[Tensor, "t rays"], adjoining: Int[Tensor, "t 9"] | None = None
) -> Float[Tensor, "t channels"]:
    """Irradiance at every texel from all others of the given radiance.

    Args:
        radiance: linear, of the texels.
        hits: as `trace_bounces` makes them.
        adjoining: as `pipeline.geometry.texels.adjoining_texels` makes them: the mean over them is taken, as light off
            other surfaces hardly changes from a texel to the next, and their rays differ.
    """
    irradiance = _sum_rows(radiance, hits) * (torch.pi / hits.shape[1])
    if adjoining is None:
        return irradiance
    return _sum_rows(irradiance, adjoining) / (adjoining < len(radiance)).sum(1, keepdim=True)


def _sum_rows(values: Float[Tensor, "t channels"], rows: Int[Tensor, "t n"]) -> Float[Tensor, "t channels"]:
    """Sum of chosen rows; one past the last is zero."""
    padded = torch.cat([values, torch.zeros_like(values[:1])])
    return torch.nn.functional.embedding_bag(rows, padded, mode="sum")
