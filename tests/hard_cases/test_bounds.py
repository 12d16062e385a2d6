"""Losses at the bounds of what they bound, logits at 0 and 1: against mpmath, beside the papers' formulas."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
import torch

from pipeline.avatar.appearance.penalties import GGX_WIDTH_BOUNDS, ROUGHNESS_BOUNDS, SMALLEST_VALUE, outside
from pipeline.avatar.networks.shadow_net import SHARE_CEILING, SHARE_FLOOR, ShadowNet
from pipeline.avatar.training.shape_losses import SCALE_BOUNDS_M
from pipeline.geometry.texels import Atlas
from tests.support.results.hard_case import HardCase, worst

FLOAT32 = 2e-6
"""A logarithm of float32 is good to 6e-8 of its value, up to 90."""

BOUNDS = {"scale": SCALE_BOUNDS_M, "roughness": ROUGHNESS_BOUNDS, "GGX width": GGX_WIDTH_BOUNDS}


def excess(value: mpmath.mpf, low: float, high: float) -> tuple[mpmath.mpf, mpmath.mpf]:
    """Squared excess in logarithms, and its slope by the value."""
    beyond = min(mpmath.mpf(0), mpmath.log(value / mpmath.mpf(low))) + max(mpmath.mpf(0), mpmath.log(value / high))
    return beyond**2, 2 * beyond / value


def papers(value: torch.Tensor, low: float, high: float) -> torch.Tensor:
    """RGCA 13: 1 / max(v, 1e-7) below, (v - high)^2 above, nothing between."""
    below, above = 1 / value.clamp_min(1e-7), (value - high).square()
    return torch.where(value < low, below, torch.where(value > high, above, torch.zeros_like(value)))


@pytest.mark.parametrize("side", ["low", "high"])
@pytest.mark.parametrize("name", BOUNDS)
def test_on_either_side_of_a_bound(case: HardCase, name: str, side: str) -> None:
    """No jump, in the value or in the slope, a thousandth of the bound to either side of it."""
    low, high = BOUNDS[name]
    bound = low if side == "low" else high
    for factor in (0.999, 1.0, 1.001):
        v = torch.tensor(bound * factor, requires_grad=True)
        loss = outside(v, low, high)
        (slope,) = torch.autograd.grad(loss, v)
        value, by_v = excess(mpmath.mpf(v.item()), low, high)
        case.check(worst(loss, value, 1.0), FLOAT32, worst(slope, by_v, 1 / bound), FLOAT32)
    if side == "low":
        steps = [papers(torch.tensor(bound * factor), low, high) for factor in (0.999, 1.001)]
        case.naive_fails(float(steps[0] - steps[1]))


@pytest.mark.parametrize("value", [1e-29, 1e-7, 1e6, 1e38])
def test_far_outside_the_bounds(case: HardCase, value: float) -> None:
    """The pull is that of the logarithm, all the way out."""
    v = torch.tensor(value, requires_grad=True)
    loss = outside(v, *SCALE_BOUNDS_M)
    (slope,) = torch.autograd.grad(loss, v)
    exact, by_v = excess(mpmath.mpf(v.item()), *SCALE_BOUNDS_M)
    case.check(worst(loss, exact), FLOAT32, worst(slope, by_v), FLOAT32)
    if not 1e-7 <= value <= 1e6:  # As printed, there is no pull below 1e-7, and no number where the square has none.
        number = torch.tensor(value, requires_grad=True)
        printed = papers(number, *SCALE_BOUNDS_M)
        (pull,) = torch.autograd.grad(printed, number)
        case.naive_fails(math.nan if printed.isinf() else worst(pull, by_v), "gradient")


@pytest.mark.parametrize("value", [0.0, 1e-44, 2e-38, 1e-37])
def test_next_to_zero(case: HardCase, value: float) -> None:
    """The slope of the logarithm, 2 log(low / v) / v, does not fit into float32: it is left out, the loss is not."""
    v = torch.tensor(value, requires_grad=True)
    low, high = SCALE_BOUNDS_M
    loss = outside(v, low, high)
    (slope,) = torch.autograd.grad(loss, v)
    case.check(worst(loss, excess(mpmath.mpf(SMALLEST_VALUE), low, high)[0]), FLOAT32, float(slope.abs()), 0)
    number = torch.tensor(value, requires_grad=True)
    tiny = torch.finfo(torch.float32).tiny
    (naive,) = torch.autograd.grad((torch.tensor(low).log() - (number + tiny).log()).square(), number)
    case.naive_fails(naive.abs(), "gradient")


def sheet(size: int) -> Atlas:
    """Two triangles that fill the map."""
    rows, columns = (index.ravel() for index in np.mgrid[:size, :size])
    faces, corners = np.array([[0, 1, 2]], np.int32), np.array([[0, 0], [0, 2], [2, 0]], np.float32)
    u, v = (columns + 0.5) / size, (rows + 0.5) / size
    texels, zero = size * size, np.zeros(size * size, np.int32)
    return Atlas(
        size, faces, corners[None], np.arange(3, dtype=np.int32), np.pad(corners, ((0, 0), (0, 1))),
        np.stack([rows, columns], 1).astype(np.int32), zero,
        np.stack([1 - u / 2 - v / 2, v / 2, u / 2], 1).astype(np.float32), zero,
        np.tile(np.array([-1, 0, 1], np.float32), (texels, 1)),
    )  # fmt: skip


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_shadow_of_all_and_of_no_light(case: HardCase, share: float) -> None:
    """A logit of 0 or 1 is infinite; the start is kept off both, and the network can still learn from there."""
    atlas = sheet(8)
    torch.manual_seed(0)
    net = ShadowNet(atlas, 4)
    texels = torch.full((64,), share)
    factor = net(texels, texels)
    slopes = torch.autograd.grad(factor.sum(), net.last.bias)
    kept = SHARE_CEILING if share else SHARE_FLOOR
    # d sigmoid = s (1 - s), once per texel.
    case.check(worst(factor, np.full(64, kept)), FLOAT32, worst(slopes[0], [64 * kept * (1 - kept)]), 1e-5)
    naive = torch.sigmoid(torch.logit(texels, eps=1e-6))  # guarded, as PyTorch offers: too far out to learn from
    case.naive_fails(worst((naive * (1 - naive)).sum(), 64 * kept * (1 - kept)), "gradient")
