"""The summed specular kernel against its float64 twin, in the middle of the lobe, at its peak and out of its reach."""

import pytest
import torch

from pipeline.lighting import device_sums
from pipeline.lighting.lobes import unit
from pipeline.lighting.point_lights import PointLights
from pipeline.lighting.specular_lobes import gather_specular, gather_specular_in_torch, gather_specular_reference

ANGLE_ERROR_RAD = 3e-7
"""Of float32 unit vectors: three roundings of half an ulp (6e-8) in each of three components. Against the narrowest
lobe (roughness / 2), at its reach of 6 sigma, the exponent moves by 6 times this over sigma, its slope 6 times more."""


def random_inputs(pixels, lights, channels, roughness):
    generator = torch.Generator().manual_seed(0)
    points = 0.3 * torch.randn(pixels, 3, generator=generator)
    centers = unit(torch.randn(pixels, 3, generator=generator))
    sigma = roughness * (0.5 + torch.rand(pixels, generator=generator))
    light = 2.4 * unit(torch.randn(lights, 3, generator=generator))
    return points, centers, sigma, light, torch.rand(lights, channels, generator=generator)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("roughness", [0.01, 0.15, 0.8])
def test_kernel_equals_float64_twin_forward_and_backward(channels, roughness):
    points, centers, sigma, light, intensity = random_inputs(500, 64, channels, roughness)
    centers[:20] = unit(light[:20] - points[:20])  # the peak itself
    inputs = [centers.requires_grad_(), sigma.requires_grad_()]
    twins = [tensor.detach().double().requires_grad_() for tensor in inputs]
    out = gather_specular(points, *inputs, PointLights(light, intensity))
    expected = gather_specular_reference(points.double(), *twins, light.double(), intensity.double())
    # an angle near the peak is good to 1e-7 rad in float32, a relative 1e-5 of the smallest roughness
    assert torch.allclose(out.double(), expected, rtol=1e-4, atol=1e-6 * expected.max().item())
    cotangent = torch.randn(out.shape, generator=torch.Generator().manual_seed(1))
    out.backward(cotangent)
    expected.backward(cotangent.double())
    for tensor, twin in zip(inputs, twins, strict=True):
        assert torch.isfinite(tensor.grad).all()
        assert (tensor.grad - twin.grad).norm() / twin.grad.norm() < ANGLE_ERROR_RAD * 6 * 6 * 2 / roughness


def test_without_the_kernel_it_is_the_same(monkeypatch):
    monkeypatch.setattr(device_sums, "PAIRS_AT_ONCE", 7 * 64)
    points, centers, sigma, light, intensity = random_inputs(40, 64, 3, 0.15)
    inputs = [centers.requires_grad_(), sigma.requires_grad_()]
    found = []
    for gather in (gather_specular, gather_specular_in_torch):
        out = gather(points, *inputs, PointLights(light, intensity))
        found.append((out, *torch.autograd.grad(out.square().sum(), inputs)))
    for single, plain in zip(*found, strict=True):
        assert torch.allclose(single, plain, rtol=1e-4, atol=1e-4 * plain.abs().max().item())


def test_points_that_require_gradient_are_refused():
    points, centers, sigma, light, intensity = random_inputs(2, 2, 1, 0.1)
    with pytest.raises(ValueError, match="detach"):
        gather_specular(points.requires_grad_(), centers, sigma, PointLights(light, intensity))


def test_no_light_and_no_pixel():
    points, centers, sigma, light, intensity = random_inputs(3, 2, 1, 0.1)
    assert (gather_specular(points, centers, sigma, PointLights(light[:0], intensity[:0])) == 0).all()
    assert gather_specular(points[:0], centers[:0], sigma[:0], PointLights(light, intensity)).shape == (0, 1)
