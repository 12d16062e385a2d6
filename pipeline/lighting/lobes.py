"""The spherical Gaussians of both papers, and the mirror direction (RGCA 6, RFGCA 13)."""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.lighting.lobe_kernels import LOBE_CONSTANT, SMALLEST_SINE2

SMALLEST_NORM = 1e-12
"""Below this a vector has no direction: it is divided by this instead of its norm, and stays finite."""


def unit(vectors: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n 3"]:
    """Vectors of length one; a zero vector stays zero, with a finite gradient."""
    return vectors / vectors.square().sum(-1, keepdim=True).add(SMALLEST_NORM**2).sqrt()


def mirror_direction(normal: Float[Tensor, "*n 3"], to_camera: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n 3"]:
    """Mirror direction q = 2 (n . w_o) n - w_o (RFGCA section 3.2.2).

    For unit vectors pointing away from the surface.
    """
    return 2 * (normal * to_camera).sum(-1, keepdim=True) * normal - to_camera


def angle_between(p: Float[Tensor, "*#n 3"], q: Float[Tensor, "*#n 3"]) -> Float[Tensor, "*out"]:
    """Angle between unit vectors in [0, pi], as atan2(|p x q|, p . q).

    acos(p . q) has infinite slope at p = q, exactly where a glint sits, and loses half the digits there.
    """
    p, q = torch.broadcast_tensors(p, q)
    sine = torch.linalg.cross(p, q).square().sum(-1).add(SMALLEST_SINE2).sqrt()
    return torch.atan2(sine, (p * q).sum(-1))


def angular_gaussian(
    p: Float[Tensor, "*#n 3"], q: Float[Tensor, "*#n 3"], sigma: Float[Tensor, "*#n"]
) -> Float[Tensor, "*out"]:
    """Spherical Gaussian of an angle (RFGCA 13).

    G(p; q, sigma) = C / sigma exp(-(angle(p, q) / sigma)^2 / 2); broadcasts like its arguments.
    """
    return LOBE_CONSTANT / sigma * torch.exp(-0.5 * (angle_between(p, q) / sigma).square())


def cosine_gaussian(
    p: Float[Tensor, "*#n 3"], q: Float[Tensor, "*#n 3"], sigma: Float[Tensor, "*#n"]
) -> Float[Tensor, "*out"]:
    """The usual spherical Gaussian, of a cosine (RGCA supplement C).

    G(p; q, lambda, mu) = mu exp(lambda (p . q - 1)).

    lambda = 1 / sigma^2 and mu = C / sigma, so that near its centre it is the angular one of the same sigma. Of unit
    vectors, p . q - 1 = -|p - q|^2 / 2, which keeps its digits where the cosine is one and nothing else.
    """
    return LOBE_CONSTANT / sigma * torch.exp(-0.5 * (p - q).square().sum(-1) / sigma.square())


Lobe = Callable[[Tensor, Tensor, Tensor], Tensor]
"""(p, q, sigma) -> G: `angular_gaussian` or `cosine_gaussian`."""
