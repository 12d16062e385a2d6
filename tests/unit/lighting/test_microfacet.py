"""Reflection of the lights that a point sees: against the plain-torch twin, and against energy and reciprocity."""

import math

import numpy as np
import pytest
import torch

from pipeline.lighting import device_sums
from pipeline.lighting.lobes import angular_gaussian, unit
from pipeline.lighting.microfacet import (
    gather_reflections,
    gather_reflections_in_torch,
    gather_reflections_reference,
)
from pipeline.lighting.point_lights import PointLights
from tests.support.lighting.seen_lights import COUNT, LIGHTS, packed, points_under_lights


@pytest.fixture
def scene():
    return points_under_lights()


BOTH = pytest.mark.parametrize("gaussian", [False, True], ids=["GGX", "Gaussian"])


@BOTH
def test_value_and_gradients_are_those_of_the_twin(scene, gaussian):
    *inputs, seen = scene
    inputs[1].requires_grad_()
    inputs[3].requires_grad_()
    found = gather_reflections(*inputs[:4], PointLights(*inputs[4:], packed(seen)), gaussian)
    doubles = [tensor.detach().double() for tensor in inputs]
    doubles[1].requires_grad_()
    doubles[3].requires_grad_()
    expected = gather_reflections_reference(*doubles, seen, gaussian)
    assert expected.abs().max() > 1e-3
    assert torch.allclose(found.double(), expected, rtol=1e-4, atol=1e-6)
    weight = torch.linspace(-1, 1, found.numel()).reshape(found.shape)
    (found * weight).sum().backward()
    (expected * weight).sum().backward()
    for single, double in ((inputs[1], doubles[1]), (inputs[3], doubles[3])):
        assert torch.allclose(single.grad.double(), double.grad, rtol=1e-3, atol=1e-4 * double.grad.abs().max().item())


@BOTH
def test_without_the_kernel_it_is_the_same(scene, monkeypatch, gaussian):
    """In pieces of five points; what every light reaches needs no mask."""
    monkeypatch.setattr(device_sums, "PAIRS_AT_ONCE", 5 * LIGHTS)
    points, normals, to_camera, alpha, lights, intensities, seen = scene
    inputs = (points, normals.requires_grad_(), to_camera, alpha.requires_grad_(), lights, intensities)
    for bits in (packed(seen), np.full((LIGHTS, COUNT // 8), 255, np.uint8)):
        gradients = []
        for gather in (gather_reflections, gather_reflections_in_torch):
            found = gather(*inputs[:4], PointLights(*inputs[4:], bits), gaussian)
            gradients.append((found, *torch.autograd.grad(found.square().sum(), (normals, alpha))))
        for single, plain in zip(*gradients, strict=True):
            assert torch.allclose(single, plain, rtol=1e-3, atol=1e-4 * plain.abs().max().item())


def test_gloss_reflects_no_more_than_schlicks_share():
    """Under light from everywhere a smooth dielectric reflects its Fresnel share: about 4 % seen from above, and a
    rough one no more (masking only takes away)."""
    rows = 4000
    height = (torch.arange(rows) + 0.5) / rows
    around = math.pi * (3 - math.sqrt(5)) * torch.arange(rows)
    across = (1 - height**2).sqrt()
    directions = torch.stack([across * around.cos(), across * around.sin(), height], -1)
    far, up = 1000.0, torch.tensor([[0.0, 0, 1]])
    power = torch.full((rows, 1), far**2 * 2 * math.pi / rows)
    seen = np.full((rows, 1), 255, np.uint8)
    shares = [
        gather_reflections(
            torch.zeros(1, 3), up, up, torch.tensor([a]), PointLights(far * directions, power, seen)
        ).item()
        for a in (0.1, 1.0)
    ]
    assert shares[0] == pytest.approx(0.04, rel=0.03)
    assert 0.01 < shares[1] < 0.04


@BOTH
def test_swapping_camera_and_light_changes_only_the_cosine(gaussian):
    """Helmholtz reciprocity: f(w_i, w_o) = f(w_o, w_i); a light of intensity d^2 gives f times its own cosine."""
    a, b = (unit(torch.tensor([v])) for v in ([0.3, 0.1, 0.8], [-0.6, 0.4, 0.5]))
    up, alpha, one = torch.tensor([[0.0, 0, 1]]), torch.tensor([0.4]), torch.full((1, 1), 9.0)
    seen = np.full((1, 1), 255, np.uint8)
    there = gather_reflections(torch.zeros(1, 3), up, a, alpha, PointLights(3 * b, one, seen), gaussian) / b[0, 2]
    back = gather_reflections(torch.zeros(1, 3), up, b, alpha, PointLights(3 * a, one, seen), gaussian) / a[0, 2]
    assert there.item() == pytest.approx(back.item(), rel=1e-5)


def test_straight_above_the_gaussian_is_the_lobe_of_the_papers():
    """Camera and mirror direction are one: the half vector's angle is half of the light's, within masking and F."""
    up, sigma, beside = torch.tensor([[0.0, 0, 1]]), torch.tensor([0.1]), 0.06
    light = torch.tensor([[math.sin(beside), 0.0, math.cos(beside)]])
    seen = np.full((1, 1), 255, np.uint8)
    found = gather_reflections(
        torch.zeros(1, 3),
        up,
        up,
        sigma / math.sqrt(2),
        PointLights(3 * light, torch.full((1, 1), 9.0), seen),
        gaussian=True,
    )
    # 1 - cos 0.06 = 0.0018 is what masking and Schlick's polynomial can change here.
    assert found.item() == pytest.approx(angular_gaussian(light, up, sigma).item(), rel=0.004)


def test_finite_at_the_horizon_and_for_the_narrowest_lobe():
    up = torch.tensor([[0.0, 0, 1]], requires_grad=True)
    alpha = torch.tensor([0.01], requires_grad=True)
    for camera in ([1.0, 0, 1e-3], [0.0, 0, 1.0], [1.0, 0, -0.2]):
        for light in ([[-1.0, 0, 1e-3]], [[0.0, 0, 1.0]], [[0.0, 0, 0.0]], [[0.5, 0.0, -1.0]]):
            seen = np.full((1, 1), 255, np.uint8)
            out = gather_reflections(
                torch.zeros(1, 3),
                up,
                unit(torch.tensor([camera])),
                alpha,
                PointLights(torch.tensor(light), torch.ones(1, 1), seen),
            )
            gradients = torch.autograd.grad(out.sum(), (up, alpha))
            assert torch.isfinite(out).all() and all(torch.isfinite(g).all() for g in gradients)
