"""The texel map of a template, and the posed point and tangent frame of each texel.

One Gaussian stands on each.

`Atlas` holds either NumPy arrays (as read) or torch tensors (`Atlas.to_torch`); `texel_frames` takes both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, Int, Int32, Int64

from pipeline.base.array_module import Array, array_module, is_tensor
from pipeline.base.errors import InputError
from pipeline.base.files import read_arrays, write_arrays
from pipeline.geometry.mesh import area_vectors, unit_or, vertex_normals

MIN_TANGENT_SINE = 1e-4
"""Sine between a texel's tangent and its normal below which the tangent says nothing: its part across the normal then
is a difference of float32 numbers that agree to four digits, good to 1e-3 at best, and another frame is built
instead."""

RIGHT, BELOW = 5, 7
"""Places of these neighbours in a row of `adjoining_texels`."""

FIELD_SHAPES = {
    "faces": ("f", 3), "uv": ("f", 3, 2), "weld": ("v",), "rest_vertices": ("v", 3), "texel": ("t", 2), "face": ("t",),
    "barycentric": ("t", 3), "chart": ("t",), "tangent_weights": ("t", 3),
}  # fmt: skip


REGION = "region."
"""Beginning of the names of arrays that hold the vertices of a region."""

FACE, HEAD, HAIR = "face", "head", "hair"
"""Regions that something asks for; a template may have others."""


def face_vertices(regions: Mapping[str, Int[np.ndarray, " _"]]) -> Int64[np.ndarray, " _"]:
    """Vertices of the face, or else of the head; none if neither is known."""
    return np.asarray(regions.get(FACE, regions.get(HEAD, ())), np.int64)


@dataclass(frozen=True)
class Atlas:
    """Map from the valid texels of a square to points of the template.

    All arrays NumPy, or all torch.

    Attributes:
        size: texels per side of the map.
        faces: corner indices into the glTF file's vertices.
        uv: texture coordinates per face corner in [0, 1], v pointing down.
        weld: vertex -> representative of all vertices at its rest position.
        rest_vertices: metres.
        texel: (row, column) of each valid texel, row 0 at the top.
        face, barycentric: the point of the mesh at the texel's centre.
        chart: connected piece of the map that the texel lies in.
        tangent_weights: the direction of increasing u is sum_i tangent_weights[i] * corner_i, not of unit length.
        regions: vertices of named parts of the surface, in ascending order, as far as they are known; always NumPy.
    """

    size: int
    faces: Int[Array, "f 3"]
    uv: Float[Array, "f 3 2"]
    weld: Int[Array, " v"]
    rest_vertices: Float[Array, "v 3"]
    texel: Int[Array, "t 2"]
    face: Int[Array, " t"]
    barycentric: Float[Array, "t 3"]
    chart: Int[Array, " t"]
    tangent_weights: Float[Array, "t 3"]
    regions: Mapping[str, Int[np.ndarray, " _"]] = field(default_factory=dict)

    @property
    def texel_count(self) -> int:
        """Number of valid texels T."""
        return len(self.face)

    @cached_property
    def corners(self) -> Int[Array, "t 3"]:
        """Vertex indices of each texel's face."""
        return self.faces[self.face]

    def texels_of(self, region: str) -> Float32[np.ndarray, " t"]:
        """Share of each texel that lies in a region.

        1 inside, 0 outside, and between them on faces across its border.
        """
        inside = np.isin(np.asarray(self.corners), self.regions.get(region, ()))
        return (inside * np.asarray(self.barycentric)).sum(1).astype(np.float32)

    def to_torch(self, device: Any = "cpu") -> Atlas:
        """The same atlas as tensors: int64 indices, float32 numbers."""
        import torch

        arrays = {name: torch.as_tensor(getattr(self, name)) for name in FIELD_SHAPES}
        tensors = {
            name: a.to(device, torch.float32 if a.is_floating_point() else torch.int64) for name, a in arrays.items()
        }
        return Atlas(self.size, **tensors, regions=self.regions)

    def chosen(self, texels: Int64[np.ndarray, " chosen"]) -> Atlas:
        """The same template with these of the texels alone."""
        of_texels = [name for name, shape in FIELD_SHAPES.items() if shape[0] == "t"]
        return replace(self, **{name: getattr(self, name)[texels] for name in of_texels})

    def to_map(self, values: Array, outside: float = 0.0) -> Array:
        """Spread values per texel [..., T] over the map [..., size, size].

        `outside` where there is no texel.
        """
        shape = (*values.shape[:-1], self.size, self.size)
        full = values.new_full(shape, outside) if is_tensor(values) else np.full(shape, outside, values.dtype)
        full[..., self.texel[:, 0], self.texel[:, 1]] = values
        return full

    def from_map(self, image: Array) -> Array:
        """Values per texel [..., T] out of a map [..., size, size]."""
        return image[..., self.texel[:, 0], self.texel[:, 1]]


def write_atlas(path: Path, atlas: Atlas) -> None:
    """Write a NumPy atlas as safetensors: `size` [1] int64, indices int32, numbers float32."""
    arrays = {name: np.asarray(getattr(atlas, name)) for name in FIELD_SHAPES}
    arrays = {name: a.astype(np.float32 if a.dtype.kind == "f" else np.int32) for name, a in arrays.items()}
    arrays |= {f"{REGION}{name}": vertices.astype(np.int32) for name, vertices in atlas.regions.items()}
    write_arrays(path, {"size": np.array([atlas.size], np.int64), **arrays})


def read_atlas(path: Path) -> Atlas:
    """Read what `write_atlas` wrote, as NumPy arrays.

    Raises:
        InputError: if an array is missing, has another shape than `FIELD_SHAPES`, or an index points nowhere.
    """
    arrays = read_arrays(path)
    missing = sorted({"size", *FIELD_SHAPES} - set(arrays))
    if missing:
        raise InputError(f"{path}: expected the arrays of an atlas, found none named {missing}; run unwrap_atlas again")
    lengths: dict[str, int] = {}
    for name, shape in FIELD_SHAPES.items():
        found = arrays[name].shape
        expected = tuple(lengths.setdefault(n, found[0] if found else 0) if isinstance(n, str) else n for n in shape)
        if found != expected:
            raise InputError(f"{path}: {name}: expected shape {expected}, found {found}; run unwrap_atlas again")
    size = int(arrays["size"].reshape(-1)[0])
    limits = {"faces": lengths["v"], "weld": lengths["v"], "face": lengths["f"], "texel": size}
    for name, limit in limits.items():
        if arrays[name].size and not 0 <= arrays[name].min() <= arrays[name].max() < limit:
            raise InputError(f"{path}: {name}: expected indices below {limit}, found others; run unwrap_atlas again")
    regions = {name.removeprefix(REGION): array for name, array in arrays.items() if name.startswith(REGION)}
    for name, vertices in regions.items():
        if vertices.size and not 0 <= vertices.min() <= vertices.max() < lengths["v"]:
            raise InputError(
                f"{path}: {name}: expected vertices below {lengths['v']}, found others; run unwrap_atlas again"
            )
    return Atlas(size, **{name: arrays[name] for name in FIELD_SHAPES}, regions=regions)


def adjoining_texels(atlas: Atlas) -> Int32[np.ndarray, "t 9"]:
    """Indices of each texel and of the eight around it.

    t, one past the last, stands for those that are not in its chart.
    """
    around = np.full((atlas.size + 2, atlas.size + 2), atlas.texel_count, np.int32)
    row, column = atlas.texel.T + 1
    around[row, column] = np.arange(atlas.texel_count)
    found = np.stack([around[row + down, column + right] for down in (-1, 0, 1) for right in (-1, 0, 1)], 1)
    charts = np.append(atlas.chart, -1)
    return np.where(charts[found] == atlas.chart[:, None], found, atlas.texel_count).astype(np.int32)


def texels_side_by_side(adjoining: Int32[np.ndarray, "t 9"]) -> Int64[np.ndarray, "2 pairs"]:
    """Every texel with the one on its right, then with the one below, where its chart has them."""
    texels = np.arange(len(adjoining))
    pairs = [np.stack([texels, adjoining[:, place]]) for place in (RIGHT, BELOW)]
    return np.concatenate([pair[:, pair[1] < len(texels)] for pair in pairs], 1).astype(np.int64)


def texel_frames(
    atlas: Atlas, vertices: Float[Array, "*b v 3"]
) -> tuple[Float[Array, "*b t 3"], Float[Array, "*b t 3 3"]]:
    """Posed point v_k and tangent frame TBN_k of each texel.

    Interpolated from the posed mesh (RFGCA, above 5 and 6).

    n: the smooth normal, barycentric mean of the vertex normals; where that is zero, the face's normal.
    t: the direction of increasing u, made orthogonal to n. b = n x t, so a frame is a proper rotation also where the
    texture is mirrored. Where the tangent vanishes or lies along n, t is any direction across n. Always finite and
    orthonormal if the vertices are finite.

    Args:
        atlas: NumPy for NumPy vertices, torch (on the vertices' device) for tensors.
        vertices: posed, in the template's vertex order.

    Returns:
        points, in the vertices' unit, and frames with columns t, b, n (world-from-texel rotations).
    """
    xp = array_module(vertices)
    weights = _as_type_of(vertices, atlas.barycentric)[..., None]
    corners = vertices[..., atlas.corners, :]
    normals = vertex_normals(vertices, atlas.faces, atlas.weld)
    smooth = (normals[..., atlas.corners, :] * weights).sum(-2)
    flat = unit_or(area_vectors(vertices, atlas.faces), _as_type_of(vertices, xp.eye(3)[2]))[..., atlas.face, :]
    n = unit_or(smooth, flat)
    # Any point of the face will do as origin of the corners (the weights sum to zero); its own keeps float32 digits.
    u_ward = ((corners - corners[..., :1, :]) * _as_type_of(vertices, atlas.tangent_weights)[..., None]).sum(-2)
    u_ward = unit_or(u_ward, 0.0)
    across = _across(u_ward, n)
    clear = (across * across).sum(-1)[..., None] > MIN_TANGENT_SINE**2
    t = unit_or(xp.where(clear, across, any_tangent(n)), 0.0)
    # A second pass removes what rounding left along n in the first: twice is enough (Parlett 1998, section 6.9).
    t = unit_or(_across(t, n), 0.0)
    return (corners * weights).sum(-2), xp.stack([t, xp.linalg.cross(n, t), n], -1)


def _across(vectors: Array, n: Array) -> Array:
    return vectors - (vectors * n).sum(-1)[..., None] * n


def any_tangent(
    n: Float[Array, "*b 3"],
) -> Float[Array, "*b 3"]:
    """A unit vector across each unit vector n.

    Duff et al. 2017, Building an Orthonormal Basis, Revisited.
    """
    xp = array_module(n)
    x, y, z = n[..., 0], n[..., 1], n[..., 2]
    sign = xp.where(z < 0, -xp.ones_like(z), xp.ones_like(z))
    a = -1 / (sign + z)
    return xp.stack([1 + sign * x * x * a, sign * x * y * a, -sign * x], -1)


def _as_type_of(like: Array, values: Array) -> Array:
    return values.to(like) if is_tensor(like) else np.asarray(values, like.dtype)
