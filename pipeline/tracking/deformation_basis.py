"""A basis of smooth mesh offsets: the slowest waves of its surface, with their amplitudes.

The waves are the eigenfunctions of the Laplace-Beltrami operator (Vallet and Levy 2008, "Spectral Geometry Processing
with Manifold Harmonics"). A Gaussian prior that gives a wave of eigenvalue k^2 the variance (1 + (l k)^2)^-2 is the
Whittle-Matern field of smoothness 1 and length l (Lindgren et al. 2011): its precision is quadratic in the Laplacian,
so it is a thin plate on a soft bed. Small pieces that hang together with nothing (eyeballs, teeth) are rigid instead.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from jaxtyping import Float64, Int64
from scipy.sparse.csgraph import connected_components

from pipeline.geometry.mesh import area_vectors, weld_vertices

LARGEST_RIGID_SHARE = 0.1
"""Of the surface's area: a larger piece deforms. Two eyeballs are 3 % of a head's surface."""

LARGEST_COTANGENT = 10.0
"""Of a triangle's angle, 6 degrees: flatter triangles, degenerate ones above all, would outweigh all others."""

LEAST_AREA_SHARE = 1e-3
"""Area of a vertex over the mean: a vertex whose faces have none (or which has no faces) still has a mass."""

BELOW_SPECTRUM = 1e-3
"""Shift for the inverse iteration, over the first guess of an eigenvalue: makes the singular Laplacian definite."""


@dataclass(frozen=True)
class DeformationBasis:
    """Offsets are `modes` @ coefficients on the pieces that deform.

    Attributes:
        modes: dimensionless, root mean square 1 over the deforming surface; zero on rigid pieces.
        sigma_m: standard deviation of each mode's coefficient, per axis.
        weight: independent offsets that each vertex stands for: its area over the squared length of the prior; zero on
            rigid pieces, and on all but one of the vertices in one place.
        part: rigid piece of each vertex, -1 where it deforms.
        centers: middle of each rigid piece, metres.
    """

    modes: Float64[np.ndarray, "vertices modes"]
    sigma_m: Float64[np.ndarray, " modes"]
    weight: Float64[np.ndarray, " vertices"]
    part: Int64[np.ndarray, " vertices"]
    centers: Float64[np.ndarray, "parts 3"]


def deformation_basis(
    vertices: Float64[np.ndarray, "vertices 3"], faces: Int64[np.ndarray, "faces 3"],
    count: int, offset_m: float, length_m: float,
) -> DeformationBasis:  # fmt: skip
    """The `count` slowest waves of a rest mesh, or fewer where it has fewer vertices.

    Args:
        offset_m: root mean square offset per axis that the prior expects.
        length_m: distance over which offsets become independent.
    """
    weld = weld_vertices(vertices, faces)
    part = rigid_parts(vertices, faces, weld)
    centers = np.array([np.unique(vertices[part == p], axis=0).mean(0) for p in range(part.max() + 1)]).reshape(-1, 3)
    lone = np.unique(weld[part < 0])
    stiffness, mass = laplacian(vertices, weld[faces])
    stiffness, mass = stiffness[lone][:, lone], mass[lone]
    weight = np.zeros(len(vertices))
    weight[lone] = mass / length_m**2
    count = min(count, len(lone) - 2)
    if count < 1:
        return DeformationBasis(np.zeros((len(vertices), 0)), np.zeros(0), weight, part, centers)
    value, vector = _slowest(stiffness, mass / mass.sum(), count)
    variance = 1 / (1 + length_m**2 * value / mass.sum()) ** 2
    row = np.full(len(vertices), -1)
    row[lone] = np.arange(len(lone))
    modes = np.where(part[:, None] < 0, vector[row[weld]], 0.0)
    return DeformationBasis(modes, offset_m * np.sqrt(variance / variance.sum()), weight, part, centers)


def _slowest(stiffness: scipy.sparse.csr_array, mass: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Smallest eigenvalues, ascending, and their eigenvectors, of stiffness x = value mass x.

    Eigenvectors have sum mass x^2 = 1.
    """
    shift = -BELOW_SPECTRUM * count
    # A fixed start makes the result the same every time.
    value, vector = scipy.sparse.linalg.eigsh(
        stiffness.tocsc(), count, scipy.sparse.diags_array(mass).tocsc(), sigma=shift, v0=np.ones(len(mass))
    )
    order = np.argsort(value)
    return np.maximum(value[order], 0.0), vector[:, order]


def rigid_parts(
    vertices: Float64[np.ndarray, "vertices 3"],
    faces: Int64[np.ndarray, "faces 3"],
    weld: Int64[np.ndarray, " vertices"],
) -> Int64[np.ndarray, " vertices"]:
    """Number of the small connected piece that each vertex belongs to, -1 for what deforms."""
    welded = weld[faces]
    links = np.concatenate([welded[:, [0, 1]], welded[:, [1, 2]], np.stack([np.arange(len(weld)), weld], 1)])
    shape = (len(vertices), len(vertices))
    count, piece = connected_components(
        scipy.sparse.coo_array((np.ones(len(links)), (links[:, 0], links[:, 1])), shape), directed=False
    )
    area = np.bincount(piece[faces[:, 0]], np.linalg.norm(area_vectors(vertices, faces), axis=1), count)
    rigid = (area > 0) & (area < LARGEST_RIGID_SHARE * area.sum())
    number = np.where(rigid, np.cumsum(rigid) - 1, -1)
    return number[piece].astype(np.int64)


def laplacian(
    vertices: Float64[np.ndarray, "vertices 3"], faces: Int64[np.ndarray, "faces 3"]
) -> tuple[scipy.sparse.csr_array, Float64[np.ndarray, " vertices"]]:
    """Cotangent stiffness matrix (Pinkall and Polthier 1993) and the area of each vertex.

    The matrix is positive semidefinite. Cotangents are clipped to `LARGEST_COTANGENT`, and not negative: then every
    offset obeys a maximum principle.
    """
    count = len(vertices)
    twice_area = np.linalg.norm(area_vectors(vertices, faces), axis=1) * 2
    rows, columns, weights = [], [], []
    for corner in range(3):
        a, b, c = (faces[:, (corner + i) % 3] for i in range(3))
        dot = ((vertices[b] - vertices[a]) * (vertices[c] - vertices[a])).sum(1)
        cotangent = np.clip(dot / np.maximum(twice_area, np.finfo(float).tiny), 0.0, LARGEST_COTANGENT)
        rows += [b, c]
        columns += [c, b]
        weights += [cotangent / 2, cotangent / 2]
    index = (np.concatenate(rows), np.concatenate(columns))
    links = scipy.sparse.coo_array((np.concatenate(weights), index), (count, count)).tocsr()
    links.setdiag(0.0)
    area = np.zeros(count)
    for corner in range(3):
        area += np.bincount(faces[:, corner], twice_area / 6, count)
    mean = area.sum() / max(np.count_nonzero(area), 1)
    stiffness = scipy.sparse.diags_array(links.sum(1)) - links
    return scipy.sparse.csr_array(stiffness), np.maximum(area, LEAST_AREA_SHARE * mean)
