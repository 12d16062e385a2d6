"""What eyes mirror, per pixel: where a pixel's ray meets the two spheres of an eye, and the normal there.

Blended normals of neighbouring Gaussians would do for skin. On a cornea a texel of a millimetre turns the mirrored ray
by 15 degrees, three times the width of its lobe, and what lies in front weighs more: glints would be spotted and off by
half a texel. The spheres are known, so that a glint is where the mirror law says, whatever the size of texels.
"""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor

from pipeline.geometry.mesh import unit_or

GRAZING = 0.02
"""Cosine between a ray and a sphere's normal below which the ray misses: slopes of the normal by the sphere's centre
stay below 50 per radius, and what is left out is the outer 0.02 % of its disc."""

LEAST_SHARE = 1e-4
"""A pixel in which eyes weigh less shows none of them."""


def trace_spheres(
    origin: Float[Tensor, "3"], rays: Float[Tensor, "n 3"], centers: Float[Tensor, "spheres 3"],
    radii: Float[Tensor, " spheres"],
) -> tuple[Float[Tensor, "n 3"], Float[Tensor, "n 3"], Int[Tensor, " hits"]]:  # fmt: skip
    """Where rays (unit) enter the union of balls: points (metres), unit normals, and the rows of rays that do.

    Zeros for the others: those that miss, graze, or start inside of the ball they would meet first. Differentiable by
    centres and radii.
    """
    toward = centers - origin
    along = rays @ toward.T
    below_root = radii**2 - (toward.square().sum(-1) - along**2)
    met = below_root > (GRAZING * radii) ** 2
    root = torch.where(met, below_root, torch.ones_like(below_root)).sqrt()
    distance = torch.where(met & (along > root), along - root, torch.inf)
    nearest, ball = distance.min(1)
    hits = torch.nonzero(torch.isfinite(nearest))[:, 0]
    points, normals = torch.zeros_like(rays), torch.zeros_like(rays)
    if not len(hits):
        return points, normals, hits
    at = origin + nearest[hits, None] * rays[hits]
    outward = unit_or(at - centers[ball[hits]], 0.0)
    return points.index_copy(0, hits, at), normals.index_copy(0, hits, outward), hits


def mirror_layer(roughness: Float[Tensor, " n"], visibility: Float[Tensor, " n"]) -> Float[Tensor, "n 2"]:
    """What is blended of eye texels: visibility, and roughness as far as it is visible."""
    return torch.stack([visibility, visibility * roughness], -1)


def mirror_pixels(
    layer: Float[Tensor, "h w 2"], spheres: tuple[Float[Tensor, "spheres 3"], Float[Tensor, " spheres"]],
    R: Float[Tensor, "3 3"], center: Float[Tensor, "3"], K: Float[Tensor, "3 3"],
) -> tuple[Tensor, ...]:  # fmt: skip
    """Row and column of the pixels in which an eye mirrors, and there: points (metres), normals, roughness and
    visibility, the last two [n]."""
    row, column = torch.nonzero(layer[..., 0].detach() > LEAST_SHARE, as_tuple=True)
    x, y = (column + 0.5 - K[0, 2]) / K[0, 0], (row + 0.5 - K[1, 2]) / K[1, 1]
    rays = unit_or(torch.stack([x, y, torch.ones_like(x)], -1) @ R, 0.0)
    points, normals, hits = trace_spheres(center, rays, *spheres)
    row, column = row[hits], column[hits]
    visibility, weighed = layer[row, column].unbind(-1)
    return row, column, points[hits].detach(), normals[hits], weighed / visibility, visibility
