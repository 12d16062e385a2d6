"""Footprints whose covariance is nearly or exactly of rank 1: the kernels' alpha against mpmath.

The naive version multiplies out the covariance and inverts it in float32, as splatting is usually written down: its
determinant is a difference of two products that agree to all their digits.
"""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
import torch

from pipeline.rendering.splat import splat
from pipeline.rendering.splat_conventions import MAX_ALPHA, MIN_ALPHA, MIN_DILATION_PX2
from pipeline.rendering.splat_types import CameraView, Gaussians, SplatOptions
from tests.support.naive.surfaces import naive_alphas
from tests.support.results.hard_case import HardCase, worst

SIZE, FOCAL, DEPTH_M, OPACITY = 24, 60.0, 2.0, 0.7

VALUE = 1e-5
"""float32 exponentials of a projection in float64 give 1e-6 (test_splatting)."""


def rotation(degrees: float) -> list[list[mpmath.mpf]]:
    """In the image plane."""
    c, s = mpmath.cos(mpmath.radians(degrees)), mpmath.sin(mpmath.radians(degrees))
    return [[c, -s], [s, c]]


def exact_alphas(scales_px: tuple[float, float], degrees: float, dilation: float) -> np.ndarray:
    """A Gaussian that lies across the optical axis, at the image's centre: V diag(s^2) V^T + dilation, EWA."""
    with mpmath.workdps(50):
        V = rotation(degrees)
        s2 = [mpmath.mpf(s) ** 2 for s in scales_px]
        cov = [
            [
                sum(V[i][k] * V[j][k] * s2[k] for k in range(2)) + (mpmath.mpf(dilation) if i == j else 0)
                for j in range(2)
            ]
            for i in range(2)
        ]
        determinant = cov[0][0] * cov[1][1] - cov[0][1] ** 2
        alphas = np.zeros((SIZE, SIZE))
        for row, column in np.ndindex(SIZE, SIZE):
            x, y = column + mpmath.mpf(0.5) - SIZE / 2, row + mpmath.mpf(0.5) - SIZE / 2
            q = (cov[1][1] * x * x - 2 * cov[0][1] * x * y + cov[0][0] * y * y) / determinant
            alphas[row, column] = float(mpmath.mpf(OPACITY) * mpmath.exp(-q / 2))
    return np.where(alphas >= MIN_ALPHA, np.minimum(alphas, MAX_ALPHA), 0.0)


@pytest.mark.parametrize(
    ("long_px", "wide_px", "dilation"),
    [(300.0, 0.0, 0.1), (3000.0, 0.0, 0.1), (3000.0, 0.3, 0.0), (3e4, 0.0, 0.1), (3e4, 0.0, 0.0)],
    ids=["300 px", "3000 px", "3000 px, 0.3 wide", "30000 px", "30000 px, no dilation"],
)
def test_needles_of_rank_1(case: HardCase, long_px: float, wide_px: float, dilation: float) -> None:
    degrees = 30.0 if dilation else 45.0  # without dilation it meets pixel centres along the diagonal only
    px = DEPTH_M / FOCAL
    half = math.radians(degrees) / 2
    scales = torch.tensor([[long_px * px, wide_px * px, 0.0]], requires_grad=True)
    gaussian = (
        torch.tensor([[0.0, 0.0, DEPTH_M]], requires_grad=True),
        torch.tensor([[math.cos(half), 0.0, 0.0, math.sin(half)]], requires_grad=True), scales,
        torch.tensor([OPACITY], requires_grad=True), torch.ones(1, 1, requires_grad=True),
    )  # fmt: skip
    K = torch.tensor([[FOCAL, 0, SIZE / 2], [0, FOCAL, SIZE / 2], [0, 0, 1]])
    view = CameraView(torch.eye(3), torch.zeros(3), K, SIZE, SIZE)
    found = splat(Gaussians(*gaussian[:4]), gaussian[4], view, SplatOptions(dilation_px2=dilation))
    slopes = torch.autograd.grad(found.alpha.sum(), gaussian[:4])
    assert all(torch.isfinite(slope).all() for slope in slopes)
    used = max(dilation, MIN_DILATION_PX2)
    # The scales that float32 holds, in pixels; and the turn that its quaternion stands for.
    held = tuple(float(s) / px for s in scales.detach()[0, :2])
    rotation = gaussian[1][0].detach()
    turn = 2 * math.degrees(math.atan2(float(rotation[3]), float(rotation[0])))
    exact = exact_alphas(held, turn, used)
    decided = np.abs(exact / MIN_ALPHA - 1) > 1e-4
    case.check(worst(found.alpha.detach().numpy()[decided], exact[decided], 1.0), VALUE)
    by_opacity = (exact / OPACITY).sum()
    case.check(gradient_error=worst(slopes[3], [by_opacity]), gradient_bound=VALUE)
    naive = naive_alphas(SIZE, OPACITY, (long_px, wide_px), degrees, used).numpy()
    case.naive_fails(worst(naive[decided], exact[decided], 1.0))
