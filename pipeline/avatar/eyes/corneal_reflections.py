"""Per-pixel corneal reflections: intersect pixel rays with the two spheres of an eye.

Blended normals of neighbouring Gaussians would do for skin. On a cornea a texel of a millimetre turns the mirrored ray
by 15 degrees, three times the width of its lobe, and what lies in front weighs more: glints would be spotted and off by
half a texel. The spheres are known, so that a glint is where the mirror law says, whatever the size of texels.
"""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor

from pipeline.avatar.appearance.glossy import GlossySamples
from pipeline.avatar.frames.prepared import PosedEyes
from pipeline.geometry.mesh import unit_or
from pipeline.rendering.splat_types import CameraView

GRAZING = 0.02
"""Cosine between a ray and a sphere's normal below which the ray misses: slopes of the normal by the sphere's centre
stay below 50 per radius, and what is left out is the outer 0.02 % of its disc."""

PIXEL_STD = 0.5
"""Standard deviation of a pixel's filter, in pixels: sums of glints then stay within 1 % wherever between pixels they
are."""

LEAST_SHARE = 1e-4
"""A pixel in which eyes weigh less shows none of them."""


def trace_spheres(
    origin: Float[Tensor, "3"], rays: Float[Tensor, "n 3"], centers: Float[Tensor, "spheres 3"],
    radii: Float[Tensor, " spheres"],
) -> tuple[Int[Tensor, " hits"], Int[Tensor, " hits"], Float[Tensor, "hits 3"], Float[Tensor, "hits 3"]]:  # fmt: skip
    """Intersect rays (unit) with the union of balls, differentiably by centres and radii.

    Rays that graze, or start inside of the ball they would meet first, do not enter it.

    Returns:
        Rows of the rays that enter, the ball each enters, points (metres) and unit normals.
    """
    toward = centers - origin
    along = rays @ toward.T
    # The distance of a ray from a centre, as a vector: |c|^2 - (c . ray)^2 would lose four digits at a metre.
    aside = toward - along[..., None] * rays[:, None]
    below_root = radii**2 - aside.square().sum(-1)
    met = below_root > (GRAZING * radii) ** 2
    root = torch.where(met, below_root, torch.ones_like(below_root)).sqrt()
    nearest, ball = torch.where(met & (along > root), along - root, torch.inf).min(1)
    rows = torch.nonzero(torch.isfinite(nearest))[:, 0]
    ball = ball[rows]
    points = origin + nearest[rows, None] * rays[rows]
    return rows, ball, points, unit_or(points - centers[ball], 0.0)


def mirror_pixels(
    layer: Float[Tensor, "h w 2"], eyes: PosedEyes, camera: CameraView
) -> tuple[Int[Tensor, " n"], Int[Tensor, " n"], GlossySamples]:
    """Row and column of the pixels in which an eye mirrors, and the samples of the lobe there.

    A step p across a sphere of radius r turns the mirrored ray by 2 p / r, on average of its two directions. A pixel
    shows the mean over what it covers, so its own width joins the lobe's, sigma'^2 = sigma^2 + (2 PIXEL_STD p / r)^2,
    and the same light is spread over sigma'^2: visibility falls by sigma / sigma', as the lobe's height has 1 / sigma'.
    """
    center, K = camera.center, camera.K
    row, column = torch.nonzero(layer[..., 0].detach() > LEAST_SHARE, as_tuple=True)
    x, y = (column + 0.5 - K[0, 2]) / K[0, 0], (row + 0.5 - K[1, 2]) / K[1, 1]
    rays = unit_or(torch.stack([x, y, torch.ones_like(x)], -1) @ camera.R, 0.0)
    hits, ball, points, normals = trace_spheres(center, rays, eyes.centers, eyes.radii)
    row, column, points = row[hits], column[hits], points.detach()
    visibility, weighed = layer[row, column].unbind(-1)
    roughness = weighed / visibility
    pixel_m = (points - center).norm(dim=-1) / K[0, 0]
    width = (roughness.square() + (2 * PIXEL_STD * pixel_m / eyes.radii.detach()[ball]).square()).sqrt()
    return row, column, GlossySamples(points, normals, width, visibility * roughness / width)
