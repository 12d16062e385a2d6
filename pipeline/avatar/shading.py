"""Shading of texels and pixels under point lights: diffuse transfer and the deferred specular lobe."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from pipeline.lighting.glints import gather_glints
from pipeline.lighting.lobes import mirror_direction, unit

COLOR_DEGREES = 4
"""Degrees 0..3 of the transfer are coloured, 4..8 monochrome (RGCA section 3.3, RFGCA 9)."""


def shade_diffuse(
    albedo: Float[Tensor, "texels 3"],
    transfer_color: Float[Tensor, "texels 3 4 3"],
    transfer_mono: Float[Tensor, "texels 3 5"],
    light: Float[Tensor, "texels 3 9 channels"],
) -> Float[Tensor, "texels 3"]:
    """c_d = albedo * sum over axes a and degrees l of z_al times the light gathered there (RFGCA 7-9)."""
    color = (transfer_color * light[:, :, :COLOR_DEGREES]).sum((1, 2))
    mono = (transfer_mono[..., None] * light[:, :, COLOR_DEGREES:]).sum((1, 2))
    return albedo * (color + mono)


def shade_specular(
    points: Float[Tensor, "pixels 3"],
    normals: Float[Tensor, "pixels 3"],
    roughness: Float[Tensor, "pixels"],
    visibility: Float[Tensor, "pixels"],
    camera_center: Float[Tensor, "3"],
    light_positions: Float[Tensor, "lights 3"],
    intensities: Float[Tensor, "lights channels"],
) -> Float[Tensor, "pixels channels"]:
    """c_s = v sum over lights of (I / d^2) G(w_i; q, sigma): RFGCA 11-12 with point lights as Diracs.

    Points in metres, normals of any length (they are blended averages), linear radiance out.
    """
    lobe_centers = mirror_direction(unit(normals), unit(camera_center - points))
    return visibility[:, None] * gather_glints(points, lobe_centers, roughness, light_positions, intensities)
