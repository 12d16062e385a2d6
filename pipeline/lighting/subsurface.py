"""Light that enters a surface in one place and leaves it in another.

A diffusion profile as a sum of Gaussians (d'Eon and Luebke 2007), over the surface at rest:

    B_k(x) = 1 / (2 pi s_k^2) integral E(y) exp(-|x - y|^2 / (2 s_k^2)) dA(y),   k = 1 .. K

with the irradiance E(y) at all points of the surface. On a flat, evenly lit surface each of them is E. Distances are
straight, through the inside: what is thin is lit from behind. They are those at rest, so that a hand on a hip exchanges
nothing. Wide Gaussians need no fine samples: each takes the mean irradiance of patches about as wide as itself.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
import scipy.sparse
import torch
from jaxtyping import Float, Float64, Int64
from scipy.spatial import cKDTree
from torch import Tensor, nn

from pipeline.geometry.texels import Atlas, texel_frames

SPREADS = (1.0, 2.0, 4.0, 8.0, 16.0)
"""Deviations of the Gaussians, in sides of a sample: each twice as wide as the one before. On held-out training
images of `subjectC`, where light goes three texels between scatterings, the widest loses 0.5 dB; on a ball of wax,
where it goes ten, images are 1.5 dB worse without."""

REACH = 3.0
"""Deviations within which a Gaussian is summed; beyond lies exp(-9 / 2) = 1.1 % of a plane's light."""

PATCH = 1.0
"""Side of the cells whose samples are one patch, in deviations."""


@dataclass(frozen=True)
class SurfaceSamples:
    """Points of a surface with unit normals, and the areas that they stand for, metres."""

    points: Float64[np.ndarray, "n 3"]
    normals: Float64[np.ndarray, "n 3"]
    areas: Float64[np.ndarray, " n"]

    @property
    def deviations(self) -> Float64[np.ndarray, " spreads"]:
        """Of the Gaussians that light spreads by, metres.

        Any for a surface without area, which sends nothing.
        """
        areas = self.areas[self.areas > 0]
        return (np.sqrt(np.median(areas)) if len(areas) else 1.0) * np.array(SPREADS)

    def at(self, chosen: Int64[np.ndarray, " m"]) -> SurfaceSamples:
        """Some of the samples."""
        return SurfaceSamples(self.points[chosen], self.normals[chosen], self.areas[chosen])

    def variances(self, means: scipy.sparse.csr_array) -> Float64[np.ndarray, " patches"]:
        """Variance of each patch along the surface, by the matrix that takes means over patches."""
        inside = means @ np.square(self.points).sum(1) - np.square(means @ self.points).sum(1)
        return np.maximum(inside, 0) / 2

    def patches(self, side: float) -> tuple[SurfaceSamples, scipy.sparse.csr_array]:
        """Samples joined in cells of a side, and the matrix that takes means over them [patches, n].

        Samples of a cell whose normals lie in different octants stay apart: thin parts have two sides.
        """
        cell = np.floor((self.points - self.points.min(0)) / side).astype(np.int64)
        octant = (self.normals > 0) @ np.array([1, 2, 4])
        patch = np.unique(np.column_stack([cell, octant]), axis=0, return_inverse=True)[1].ravel()
        count, own = patch.max() + 1, np.arange(len(patch))
        joined = scipy.sparse.csr_array((self.areas, (patch, own)), shape=(count, len(patch)))
        areas = joined.sum(1)
        means = scipy.sparse.diags_array(1 / np.maximum(areas, np.finfo(float).tiny)) @ joined
        return SurfaceSamples(means @ self.points, means @ self.normals, areas), means


def surface_at_rest(atlas: Atlas, spacing: Float64[np.ndarray, "texels 2"]) -> SurfaceSamples:
    """Texels at rest; `spacing`: size of each along tangent and bitangent, metres."""
    points, frames = texel_frames(atlas, atlas.rest_vertices.astype(np.float64))
    return SurfaceSamples(points, frames[..., 2], spacing.prod(1))


def gaussian_spread(surface: SurfaceSamples, deviation: float) -> tuple[scipy.sparse.csr_array, scipy.sparse.csr_array]:
    """Matrices of one Gaussian: kernel [n, patches] and means [patches, n].

    The second takes the mean irradiance of patches, the first spreads these.

    Args:
        surface: its samples, those of area 0 neither send nor count.
        deviation: of the Gaussian, metres.
    """
    patches, means = surface.patches(PATCH * deviation)
    # A patch is no point: what leaves it is as wide as the Gaussian and the patch together.
    width2 = deviation**2 + surface.variances(means)
    near = cKDTree(surface.points).sparse_distance_matrix(
        cKDTree(patches.points), REACH * deviation, output_type="coo_matrix"
    )
    own = width2[near.col]
    weight = np.exp(-0.5 * np.square(near.data) / own) / (2 * np.pi * own) * patches.areas[near.col]
    kernel = scipy.sparse.csr_array((weight, (near.row, near.col)), shape=(len(surface.points), len(patches.points)))
    return kernel, means


class SubsurfaceSpread(nn.Module):
    """Learned sum of Gaussians that irradiance spreads by; it starts at nothing.

    Args:
        surface: samples at rest.
        where: samples that light enters and leaves; all if None.
    """

    def __init__(self, surface: SurfaceSamples, where: Int64[np.ndarray, " m"] | None = None) -> None:
        super().__init__()
        self.count, self.weight = len(surface.points), nn.Parameter(torch.zeros(len(SPREADS), 3))
        chosen = np.arange(self.count) if where is None else where
        part = surface.at(chosen)
        self.register_buffer("where", torch.as_tensor(chosen), persistent=False)
        for number, deviation in enumerate(surface.deviations):
            kernel, means = gaussian_spread(part, float(deviation))
            self.register_buffer(f"kernel_{number}", in_torch(kernel), persistent=False)
            self.register_buffer(f"means_{number}", in_torch(means), persistent=False)

    def forward(self, irradiance: Float[Tensor, "n channels"]) -> Float[Tensor, "n 3"]:
        """Light that spreads from where it entered, as irradiance; no gradient flows to what enters."""
        entering = irradiance.detach()[self.where]
        leaving = entering.new_zeros(len(entering), 3)
        for number, weight in enumerate(self.weight):
            means, kernel = (self.get_buffer(f"{name}_{number}") for name in ("means", "kernel"))
            spread = product(kernel, product(means, entering))
            leaving = leaving + weight * spread
        return entering.new_zeros(self.count, 3).index_copy(0, self.where, leaving)


def product(matrix: Tensor, light: Float[Tensor, "n channels"]) -> Float[Tensor, "rows channels"]:
    """Product of a sparse matrix with light."""
    return matrix @ light


def in_torch(matrix: scipy.sparse.csr_array) -> Tensor:
    """A sparse matrix in float32."""
    matrix = matrix.sorted_indices()
    arrays = (matrix.indptr.astype(np.int32), matrix.indices.astype(np.int32), matrix.data.astype(np.float32))
    parts = [torch.as_tensor(array) for array in arrays]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # CSR is in beta, torch says: what is used of it is tested here
        return torch.sparse_csr_tensor(*parts, size=matrix.shape, check_invariants=True)
