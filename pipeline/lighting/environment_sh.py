"""Light of an environment map by spherical harmonics, for the transfer (RFGCA 7-9).

A zonal lobe about axis a gathers from distant lights of irradiance E_j, with the addition theorem read backwards,

    sum_j E_j (2 l + 1) / (4 pi) P_l(a . w_j) = sum_m Y_lm(a) L_lm,   L_lm = sum_j E_j Y_lm(w_j)

so only the 81 coefficients of degrees 0..8 of the light matter, and no frame pays for the number of pixels. The two
sides agree to rounding: nothing of the light is left out that degree 8 could see. Points at all places share the
coefficients, which is what "distant" means.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from pipeline.lighting.environment import Environment
from pipeline.lighting.zonal import DEGREES

COEFFICIENTS = DEGREES**2


def spherical_harmonics(directions: Float[Tensor, "n 3"], degrees: int = DEGREES) -> Float[Tensor, "n {degrees**2}"]:
    """Real, orthonormal Y_lm of unit directions for l < degrees.

    At index l^2 + l + m, where those with m < 0 are the sines.

    Polynomials of x, y, z (Sloan 2013, Efficient Spherical Harmonic Evaluation): no angle, so finite with finite
    gradients everywhere, the poles on z included. Without the Condon-Shortley sign, which no sum over m sees.
    """
    x, y, z = directions.unbind(-1)
    columns: list[Tensor] = [z] * degrees**2
    cosine, sine = torch.ones_like(z), torch.zeros_like(z)  # of m times the azimuth, times sin(polar angle)^m
    diagonal = math.sqrt(1 / (4 * math.pi))
    for m in range(degrees):
        before, here = torch.zeros_like(z), torch.full_like(z, diagonal)
        for degree in range(m, degrees):
            center = degree * degree + degree
            columns[center + m] = here * cosine * (math.sqrt(2) if m else 1)
            columns[center - m] = here * sine * math.sqrt(2) if m else here
            # The recursion in the degree of normalised associated Legendre functions without their sin^m.
            step = math.sqrt((4 * (degree + 1) ** 2 - 1) / ((degree + 1) ** 2 - m * m))
            back = math.sqrt((degree * degree - m * m) / (4 * degree * degree - 1)) if degree > m else 0.0
            before, here = here, step * (z * here - back * before)
        cosine, sine = x * cosine - y * sine, x * sine + y * cosine
        diagonal *= math.sqrt((2 * m + 3) / (2 * m + 2))
    return torch.stack(columns, -1)


def project_environment(environment: Environment) -> Float64[np.ndarray, "81 3"]:
    """L_lm of all pixels, linear RGB. A row at a time, for a large map's harmonics fill no memory."""
    rows = zip(environment.directions(), environment.radiance * environment.solid_angles()[:, None, None], strict=True)
    return sum(spherical_harmonics(torch.from_numpy(row)).numpy().T @ irradiances for row, irradiances in rows)


def even_directions(count: int) -> Float64[np.ndarray, "n 3"]:
    """Unit directions spread evenly over the sphere (Fibonacci lattice)."""
    place = np.arange(count) + 0.5
    height, angle = 1 - 2 * place / count, np.pi * (1 + np.sqrt(5)) * place
    across = np.sqrt(1 - height**2)
    return np.stack([across * np.cos(angle), across * np.sin(angle), height], 1)


def turned_light(light: Float[Tensor, "81 channels"], turn: Float[Tensor, "3 3"]) -> Float[Tensor, "81 channels"]:
    """L_lm of light whose directions are turned by `turn`.

    Harmonics of turned directions are sums of harmonics of the same degree: Y(turn w) = D Y(w). D is found at more
    directions than there are harmonics, in float64, which is exact to rounding.
    """
    directions = torch.as_tensor(even_directions(4 * COEFFICIENTS))
    still, moved = (spherical_harmonics(d) for d in (directions, directions @ turn.detach().double().cpu().T))
    turned = torch.zeros(light.shape, dtype=torch.float64)
    for degree in range(DEGREES):
        own = slice(degree**2, (degree + 1) ** 2)
        D = torch.linalg.lstsq(still[:, own], moved[:, own]).solution.T
        turned[own] = D @ light[own].double().cpu()
    return turned.to(light)


def gather_environment(
    axes: Float[Tensor, "points 3 3"], light: Float[Tensor, "coefficients channels"]
) -> Float[Tensor, "points 3 degrees channels"]:
    """Gather incident light per axis and degree.

    As `pipeline.lighting.zonal.gather_light`, of distant lights.

    Args:
        axes: rotation matrices; column a is the axis of lobe a.
        light: L_lm of as many degrees as are asked for, linear RGB.
    """
    degrees = math.isqrt(len(light))
    harmonics = spherical_harmonics(axes.mT.reshape(-1, 3), degrees).reshape(len(axes), 3, degrees**2)
    gathered = [harmonics[..., n * n : (n + 1) ** 2] @ light[n * n : (n + 1) ** 2] for n in range(degrees)]
    return torch.stack(gathered, -2)
