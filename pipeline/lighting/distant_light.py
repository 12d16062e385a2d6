"""Point lights that are far enough to be alike on the whole subject, for the transfer's lobes, in two equal forms.

By Legendre polynomials (`pipeline.lighting.zonal`) every light costs each point 27 terms, one per axis and degree. By
spherical harmonics of the lighting (`pipeline.lighting.environment_sh`) the lights are summed to 81 coefficients once,
and a point costs the same however many there are. So few lights go the first way and many the second (RFGCA 7-9).

Lights nearby have another direction at every point, and 81 coefficients of each point would have to be summed over the
lights: three times the terms of the Legendre form, at any number of lights. They always go the first way.
`python -m benchmarks.bench_zonal` times all of this.
"""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from pipeline.lighting.environment_sh import gather_environment, spherical_harmonics
from pipeline.lighting.lobes import unit
from pipeline.lighting.zonal import SMALLEST_DISTANCE2_M2, gather_light

HARMONICS_FROM = 64
"""Number of distant lights from which their spherical harmonics are faster, forward and backward."""


def as_distant(
    center: Float[Tensor, "3"], positions: Float[Tensor, "lights 3"], intensities: Float[Tensor, "lights channels"]
) -> tuple[Float[Tensor, "lights 3"], Float[Tensor, "lights channels"]]:
    """Directions and irradiances, I / d^2, of point lights as seen from one place; metres, linear."""
    offsets = positions - center
    distance2 = offsets.square().sum(-1, keepdim=True).clamp_min(float(SMALLEST_DISTANCE2_M2))
    return unit(offsets), intensities / distance2


def project_lights(
    directions: Float[Tensor, "lights 3"], irradiances: Float[Tensor, "lights channels"]
) -> Float[Tensor, "81 channels"]:
    """L_lm of distant lights."""
    return spherical_harmonics(directions).T @ irradiances


def gather_by_legendre(
    axes: Float[Tensor, "points 3 3"],
    directions: Float[Tensor, "lights 3"],
    irradiances: Float[Tensor, "lights channels"],
) -> Float[Tensor, "points 3 9 channels"]:
    """Light per axis and degree: lights at 1 m of points at the origin are distant ones of the same number."""
    return gather_light(axes.new_zeros(len(axes), 3), axes, directions, irradiances)


def gather_distant(
    axes: Float[Tensor, "points 3 3"],
    directions: Float[Tensor, "lights 3"],
    irradiances: Float[Tensor, "lights channels"],
) -> Float[Tensor, "points 3 9 channels"]:
    """Incident light per axis and degree, differentiable in `axes`, in the form that is faster for so many lights.

    Args:
        axes: rotation matrices; column a is the axis of lobe a.
        directions: unit vectors to the lights.
        irradiances: linear; one channel for white lights, three for coloured ones.
    """
    if len(directions) < HARMONICS_FROM:
        return gather_by_legendre(axes, directions, irradiances)
    return gather_environment(axes, project_lights(directions, irradiances))
