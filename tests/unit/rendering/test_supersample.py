"""Supersampling: the average of a larger image, with the geometry in place."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from pipeline.rendering import supersample
from tests.support.avatars.splat_by_names import splat, splat_supersampled

ROUNDING = 1e-5
"""float32 images near 1."""

CAMERA = {
    "R": torch.eye(3), "t": torch.zeros(3), "K": torch.tensor([[40.0, 0, 10.5], [0, 42.0, 8.0], [0, 0, 1]]),
    "width": 21, "height": 16,
}  # fmt: skip


def scene(count=40, seed=0):
    draws = torch.Generator().manual_seed(seed)
    means = (torch.rand(count, 3, generator=draws) - 0.5) * torch.tensor([1.0, 0.7, 0.5]) + torch.tensor(
        [0.0, 0.0, 2.0]
    )
    return {
        "means": means,
        "quaternions": torch.randn(count, 4, generator=draws),
        "scales": 0.05 * torch.rand(count, 3, generator=draws),
        "opacities": torch.rand(count, generator=draws),
        "features": torch.rand(count, 3, generator=draws),
    }


@pytest.mark.parametrize("factor", [1, 2, 3])
def test_box_filter_is_the_mean_of_each_pixels_samples(factor):
    K = CAMERA["K"] * torch.tensor([[factor], [factor], [1.0]])
    large = splat(**scene(), **{**CAMERA, "K": K, "width": 21 * factor, "height": 16 * factor})
    small = splat_supersampled(**scene(), **CAMERA, factor=factor)
    for got, fine in zip(small, large, strict=True):
        blocks = fine.numpy().reshape(16, factor, 21, factor, -1).mean((1, 3)).reshape(got.shape)
        np.testing.assert_allclose(got, blocks, atol=ROUNDING)


@pytest.mark.parametrize("factor", [1, 2, 3])
def test_gaussian_filter_keeps_place_and_light_up_to_the_border(factor):
    """A wall of even alpha stays even, also at the border; a dot keeps its centroid and its sum."""
    wall = {
        "means": torch.tensor([[0.0, 0.0, 2.0]]), "quaternions": torch.tensor([[1.0, 0, 0, 0]]),
        "scales": torch.full((1, 3), 1e3), "opacities": torch.tensor([0.7]), "features": torch.tensor([[1.0]]),
    }  # fmt: skip
    even = splat_supersampled(**wall, **CAMERA, factor=factor, filter="gaussian")
    np.testing.assert_allclose(even.alpha, 0.7, atol=ROUNDING)
    dot = {**wall, "means": torch.tensor([[0.03, -0.02, 2.0]]), "scales": torch.full((1, 3), 0.05)}
    plain = splat_supersampled(**dot, **CAMERA, factor=factor).alpha.numpy()
    soft = splat_supersampled(**dot, **CAMERA, factor=factor, filter="gaussian").alpha.numpy()
    np.testing.assert_allclose(soft.sum(), plain.sum(), rtol=1e-3)
    x, y = np.meshgrid(np.arange(21) + 0.5, np.arange(16) + 0.5)
    np.testing.assert_allclose([(soft * x).sum() / soft.sum(), (soft * y).sum() / soft.sum()], [11.1, 7.58], atol=0.01)
    assert soft.max() < plain.max()


def test_gradients_pass_through_the_filter():
    for filter in ("box", "gaussian"):
        leaves = {name: a.requires_grad_() for name, a in scene().items()}
        out = splat_supersampled(**leaves, **CAMERA, filter=filter)
        (out.features.square().sum() + out.depth.sum()).backward()
        assert all(torch.isfinite(a.grad).all() and a.grad.any() for a in leaves.values())


def test_unknown_filters_are_refused():
    with pytest.raises(Exception, match="tent"):
        splat_supersampled(**scene(), **CAMERA, filter="tent")


@pytest.mark.parametrize(("factor", "std_px"), [(1, 0.5), (2, 0.5), (3, 0.4), (2, 2.0)])
def test_filter_kernel_equals_its_float64_twin(factor, std_px):
    """Forward to float32's rounding of a few dozen terms near 1, and its gradient likewise."""
    weights = supersample._gaussian(factor, std_px)
    size = [factor * side + len(weights) - factor for side in (7, 9)]
    images = torch.rand(*size, 5, generator=torch.Generator().manual_seed(0), requires_grad=True)
    twin = images.detach().double().requires_grad_()
    found = supersample.filter_down(images, weights, factor)
    expected = supersample.filter_down_reference(twin, weights.double(), factor)
    assert found.shape == (7, 9, 5)
    np.testing.assert_allclose(found.detach(), expected.detach(), atol=ROUNDING)
    cotangent = torch.randn(found.shape, generator=torch.Generator().manual_seed(1))
    found.backward(cotangent)
    expected.backward(cotangent.double())
    np.testing.assert_allclose(images.grad, twin.grad, atol=ROUNDING)
