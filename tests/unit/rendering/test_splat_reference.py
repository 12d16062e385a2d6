"""The dense reference against finite differences and against textbook formulas."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from pipeline.rendering.splat_reference import (
    blend_weights,
    footprint_alphas,
    project_footprints,
    rotations_from_quaternions,
    splat_reference,
)
from pipeline.rendering.splat_types import CameraView, Gaussians, SplatOptions

FLOAT64_ROUNDING = 1e-12
"""A few dozen operations on numbers near 1."""


@pytest.mark.parametrize("compensate", [False, True])
def test_gradients_agree_with_finite_differences(compensate):
    draws = torch.Generator().manual_seed(3)
    count = 3
    means = torch.randn(count, 3, generator=draws, dtype=torch.float64) * 0.15 + torch.tensor([0.0, 0.0, 2.0])
    rest = [torch.randn(count, 4, generator=draws), 0.1 + 0.1 * torch.rand(count, 3, generator=draws)]
    rest += [0.3 + 0.5 * torch.rand(count, generator=draws), torch.randn(count, 2, generator=draws)]
    inputs = tuple(a.double().requires_grad_() for a in (means, *rest))
    R = torch.from_numpy(Rotation.from_rotvec([0.1, 0.05, -0.3]).as_matrix())
    K = torch.tensor([[12.0, 0, 3.2], [0, 13.0, 2.8], [0, 0, 1]], dtype=torch.float64)

    def render(*leaves):
        view, options = CameraView(R, torch.zeros(3), K, 5, 4), SplatOptions(compensate_opacity=compensate)
        return tuple(splat_reference(Gaussians(*leaves[:4]), leaves[4], view, options))

    assert torch.autograd.gradcheck(render, inputs, eps=1e-7, atol=1e-5, rtol=1e-4)


def test_rotations_are_those_of_scipy_for_quaternions_of_any_length():
    quaternions = np.random.default_rng(0).normal(size=(50, 4)) * 3
    expected = Rotation.from_quat(quaternions[:, [1, 2, 3, 0]]).as_matrix()
    np.testing.assert_allclose(
        rotations_from_quaternions(torch.from_numpy(quaternions)), expected, atol=FLOAT64_ROUNDING
    )
    zero = torch.zeros(1, 4, dtype=torch.float64, requires_grad=True)
    rotation = rotations_from_quaternions(zero)
    rotation.sum().backward()
    assert torch.equal(rotation[0], torch.eye(3, dtype=torch.float64)) and not zero.grad.any()


def test_alpha_of_a_needle_is_that_of_the_inverse_covariance_in_high_precision():
    """3,000 px long, 0.01 px wide, no dilation to speak of: where a 2 x 2 inverse in float64 loses its digits."""
    scales = torch.tensor([[60.0, 2e-4, 1e-4]], dtype=torch.float64)
    quaternion = torch.tensor([[0.9, 0.1, -0.2, 0.3]], dtype=torch.float64)
    mean = torch.tensor([[0.1, -0.05, 2.0]], dtype=torch.float64)
    K = torch.tensor([[100.0, 0, 40], [0, 100.0, 40], [0, 0, 1]], dtype=torch.float64)
    eye, zero = torch.eye(3, dtype=torch.float64), torch.zeros(3, dtype=torch.float64)
    needle = Gaussians(mean, quaternion, scales, torch.ones(1).double())
    seen = project_footprints(needle, CameraView(eye, zero, K, 80, 80), SplatOptions(dilation_px2=1e-3))
    along = seen.factor[0, :, 0] / seen.factor[0, :, 0].norm()
    pixels = seen.center_px + along * torch.tensor([[0.0], [20.0], [-35.0], [5.0]]) + torch.tensor([[0.02, 0.03]])
    with mpmath.workdps(50):
        M = mpmath.matrix(seen.factor[0].tolist())
        inverse = (M * M.T + mpmath.mpf(seen.dilation_px2) * mpmath.eye(2)) ** -1
        offsets = [mpmath.matrix((p - seen.center_px[0]).tolist()) for p in pixels]
        expected = [float(mpmath.exp(-(d.T * inverse * d)[0] / 2)) for d in offsets]
    assert min(expected) > 0.1
    # Pixel offsets of 40 px are exact to 7e-15 px, the needle is 0.03 px wide: 1e-10 in q, with room.
    np.testing.assert_allclose(footprint_alphas(seen, pixels)[:, 0], expected, rtol=1e-8)


def test_weights_and_transmittance_add_up_to_one():
    alphas = torch.rand(20, 30, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    weights, transmittance = blend_weights(alphas)
    np.testing.assert_allclose(weights.sum(1) + transmittance, 1, atol=FLOAT64_ROUNDING)
    assert (transmittance > 1e-4).all()
