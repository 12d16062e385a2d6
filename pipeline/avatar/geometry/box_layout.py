"""Layout of boxes on patches of the atlas, on the template at rest.

Where they stand, and which texels their voxels belong to. The atlas is cut into squares; the texels of one chart in one
square make a patch, and each patch has a box in the tangent frame of its middle texel. Boxes are larger than their
patches, as they fade out towards their faces. A column of voxels belongs to the texel that is nearest to it, of its own
patch or the next, across seams too: where boxes overlap they show the same. Each texel has layers of voxels, evenly
spaced along its normal about the surface; voxels of a box lie between them, however the surface bends in the box.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import torch
from jaxtyping import Float, Int, Int64
from scipy.spatial import cKDTree
from torch import Tensor

from pipeline.geometry.texel_surface import surface_frames
from pipeline.geometry.texels import Atlas
from pipeline.rendering.volume_conventions import FADE_POWER, FADE_SCALE

REACH = (FADE_SCALE / np.log(2)) ** (1 / FADE_POWER)
"""Half size of a box in half sizes of its patch, 1.36: both boxes have faded to half where their patches meet."""

BENDING = REACH**2
"""By how much more the surface may leave a box's plane than it does within the patch: like the square of the way."""

DEPTH = 0.5
"""How far layers reach off the surface, in half sizes of a patch: layers are half as far apart as texels."""

FARTHEST_TEXEL = 1.5
"""Spacings of a box's columns beyond which no texel is near enough to a column to be its own: there is no surface."""

SMALLEST_COSINE = 0.2
"""Of the angle between the normals of a box and of a texel: beyond 78 degrees, columns run along the surface."""


@dataclass(frozen=True)
class BoxLayout:
    """Boxes on the template at rest.

    Attributes:
        anchor: the texel in whose tangent frame a box stands.
        shift: from there to the box's centre, in that frame, metres.
        half_size: along its axes, metres.
        texel: of each column of voxels.
        lower, upper: of each voxel, the layers of that texel on either side, counted through all texels.
        share: of the upper one.
        filled: 1 for voxels among the layers of a texel, 0 for those above, below or beside.
        thickness_m: between two layers.
    """

    anchor: Int[Tensor, " b"]
    shift: Float[Tensor, "b 3"]
    half_size: Float[Tensor, "b 3"]
    texel: Int[Tensor, "b m m"]
    lower: Int[Tensor, "b deep m m"]
    upper: Int[Tensor, "b deep m m"]
    share: Float[Tensor, "b deep m m"]
    filled: Float[Tensor, "b deep m m"]
    thickness_m: Float[Tensor, ""]

    def named(self) -> dict[str, Tensor]:
        """Tensors by name, in the order of the attributes."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


def lay_boxes(atlas: Atlas, spacing_m: Float[np.ndarray, "t 2"], voxels: int) -> BoxLayout:
    """Lay boxes of `voxels` cubed on the template at rest.

    Args:
        spacing_m: of texels on it, along tangent and bitangent.
    """
    points, frames = surface_frames(atlas, atlas.rest_vertices)
    side = max(1, round(voxels / REACH))
    patch = patches(atlas, side)
    anchor = middle_texels(points, patch)
    local = np.einsum("tij,ti->tj", frames[anchor[patch]], points - points[anchor[patch]])
    low, high = extremes(local, patch)
    deep = DEPTH * side * float(spacing_m.mean()) / 2
    half = REACH * ((high - low) + np.append(spacing_m[anchor], np.zeros((len(anchor), 1)), 1)) / 2
    half[:, 2] = BENDING * (high - low)[:, 2] / 2 + deep
    shift = (low + high) / 2

    grid = np.linspace(-1, 1, voxels)
    rows, columns = np.meshgrid(grid, grid, indexing="ij")
    plane = np.stack([columns, rows, np.zeros_like(rows)], -1)
    of_box = shift[:, None, None] + plane * half[:, None, None]
    places = points[anchor][:, None, None] + np.einsum("bij,brcj->brci", frames[anchor], of_box)
    texel = cKDTree(points).query(places)[1]
    turned = np.einsum("bij,brci->brcj", frames[anchor], points[texel] - points[anchor][:, None, None])
    aside = (of_box - turned)[..., :2]
    beside = np.linalg.norm(aside, axis=-1)
    near = FARTHEST_TEXEL * 2 * half[:, :2].max(1) / (voxels - 1)
    normals = np.einsum("bij,brci->brcj", frames[anchor], frames[texel][..., 2])
    faces = normals[..., 2] > SMALLEST_COSINE

    # Where a column meets the plane that touches the surface at its texel.
    rise = (normals[..., :2] * aside).sum(-1) / normals[..., 2].clip(SMALLEST_COSINE)
    surface = turned[..., 2] - rise
    height = (shift[:, 2, None] + half[:, 2, None] * grid)[..., None, None] - surface[:, None]
    at = (height / deep + 1) / 2 * (voxels - 1)
    lower = np.floor(at).astype(np.int64).clip(0, voxels - 2)
    filled = (at >= 0) & (at <= voxels - 1) & ((beside <= near[:, None, None]) & faces)[:, None]
    first = texel[:, None] * voxels + lower
    numbers = {"shift": shift, "half_size": half, "share": (at - lower).clip(0, 1), "filled": filled}
    numbers["thickness_m"] = 2 * deep / (voxels - 1)
    found = {name: torch.as_tensor(np.asarray(array, np.float32)) for name, array in numbers.items()}
    indices = {"anchor": anchor, "texel": texel, "lower": first, "upper": first + 1}
    return BoxLayout(**{name: torch.as_tensor(array) for name, array in indices.items()}, **found)


def patches(atlas: Atlas, side: int) -> Int64[np.ndarray, " t"]:
    """Number of each texel's patch: texels of one chart in one square of `side` texels."""
    squares = np.concatenate([atlas.texel // side, atlas.chart[:, None]], 1)
    return np.unique(squares, axis=0, return_inverse=True)[1].reshape(-1)


def middle_texels(points: Float[np.ndarray, "t 3"], patch: Int[np.ndarray, " t"]) -> Int64[np.ndarray, " b"]:
    """The texel of each patch that is nearest to its centroid."""
    counts = np.bincount(patch)
    sums = np.stack([np.bincount(patch, weights=axis) for axis in points.T], 1)
    away = np.linalg.norm(points - (sums / counts[:, None])[patch], axis=1)
    order = np.lexsort((away, patch))
    return order[np.cumsum(counts) - counts]


def extremes(
    values: Float[np.ndarray, "t 3"], patch: Int[np.ndarray, " t"]
) -> tuple[Float[np.ndarray, "b 3"], Float[np.ndarray, "b 3"]]:
    """Smallest and largest values of each patch."""
    order = np.argsort(patch, kind="stable")
    counts = np.bincount(patch)
    starts = np.cumsum(counts) - counts
    return np.minimum.reduceat(values[order], starts), np.maximum.reduceat(values[order], starts)
