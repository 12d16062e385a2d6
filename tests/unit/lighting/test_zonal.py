"""Light gathered by degree: against a Lambertian analytic answer, spherical harmonics and the float64 twin."""

import math

import numpy as np
import pytest
import torch
from scipy.special import sph_harm_y

from pipeline.lighting import device_sums
from pipeline.lighting.point_lights import PointLights
from pipeline.lighting.zonal import (
    DEGREES,
    SMALLEST_DISTANCE2_M2,
    clamped_cosine_coefficients,
    gather_light,
    gather_light_in_torch,
    gather_light_reference,
)
from tests.support.rigs.random_lights import FLOAT32_SUM, random_scene


@pytest.mark.parametrize("channels", [1, 3])
def test_kernel_equals_float64_twin_forward_and_backward(channels):
    place, axes, light, intensity = random_scene(300, 64, channels)
    inputs = [place.requires_grad_(), axes.requires_grad_()]
    twins = [tensor.detach().double().requires_grad_() for tensor in inputs]
    out = gather_light(*inputs, PointLights(light, intensity))
    expected = gather_light_reference(*twins, light.double(), intensity.double())
    assert (out - expected).abs().max() < FLOAT32_SUM
    cotangent = torch.randn(out.shape, generator=torch.Generator().manual_seed(1))
    out.backward(cotangent)
    expected.backward(cotangent.double())
    for tensor, twin in zip(inputs, twins, strict=True):
        assert (tensor.grad - twin.grad).norm() / twin.grad.norm() < 1e-5


def test_without_the_kernel_it_is_the_same(monkeypatch):
    """In pieces of seven points, with a mask and without."""
    monkeypatch.setattr(device_sums, "PAIRS_AT_ONCE", 7 * 64)
    place, axes, light, intensity = random_scene(40, 64, 3)
    inputs = [place.requires_grad_(), axes.requires_grad_()]
    some = np.packbits(np.random.default_rng(0).random((64, 40)) < 0.5, axis=1)
    for seen in (some, np.full_like(some, 255)):
        found = []
        for gather in (gather_light, gather_light_in_torch):
            out = gather(*inputs, PointLights(light, intensity, seen))
            found.append((out, *torch.autograd.grad(out.square().sum(), inputs)))
        assert (found[0][0] - found[1][0]).abs().max() < FLOAT32_SUM
        for gradient, plain in zip(found[0][1:], found[1][1:], strict=True):
            assert (gradient - plain).norm() / plain.norm() < 1e-5


def test_addition_theorem_against_spherical_harmonics():
    """sum_m Y_lm(a) Y_lm(w), from SciPy's harmonics, is what is gathered along axis a for a light in direction w."""
    place, axes, light, _ = random_scene(5, 1, 1, seed=3)
    gathered = gather_light(place, axes, PointLights(light, torch.ones(1, 1))).double().numpy()[..., 0]
    for point in range(len(place)):
        to_light = (light[0] - place[point]).double().numpy()
        distance = np.linalg.norm(to_light)
        for axis in range(3):
            a, w = axes[point, :, axis].double().numpy(), to_light / distance
            for degree in range(DEGREES):
                values = [
                    [sph_harm_y(degree, m, math.acos(np.clip(d[2], -1, 1)), math.atan2(d[1], d[0])) for d in (a, w)]
                    for m in range(-degree, degree + 1)
                ]
                expected = sum((x * np.conj(y)).real for x, y in values) / distance**2
                assert gathered[point, axis, degree] == pytest.approx(expected, abs=5e-6)


def test_lambertian_lobe_approximates_the_clamped_cosine():
    """Degree 8 of max(0, cos) / pi: it errs most at the kink, by its own value there, as the cosine has none.

    The series is 1/4 + x/2 + 5/16 P2 - 3/32 P4 + 13/256 P6 - 17/512 P8, and P_l(0) are -1/2, 3/8, -5/16 and 35/128.
    """
    at_the_kink = 1 / 4 - 5 / 16 / 2 - 3 / 32 * 3 / 8 - 13 / 256 * 5 / 16 - 17 / 512 * 35 / 128
    coefficients = clamped_cosine_coefficients()
    degree = np.arange(DEGREES)
    cosine = np.linspace(-1, 1, 2001)
    series = np.polynomial.legendre.legval(cosine, coefficients * (2 * degree + 1) / (4 * np.pi))
    assert np.abs(series - np.maximum(cosine, 0) / np.pi).max() == pytest.approx(at_the_kink / np.pi, rel=1e-9)
    assert coefficients[:3] == pytest.approx([1.0, 2 / 3, 1 / 4], abs=1e-12)
    assert coefficients[3] == pytest.approx(0, abs=1e-12)


def test_inverse_square_falloff():
    axes = torch.eye(3).expand(2, 3, 3).contiguous()
    place = torch.tensor([[0.0, 0, 0], [0, 0, 1.0]])
    out = gather_light(place, axes, PointLights(torch.tensor([[0.0, 0, 2.0]]), torch.ones(1, 1)))
    assert (out[1] / out[0]).flatten()[2 * DEGREES].item() == pytest.approx(4, rel=1e-6)


def test_light_on_the_point_is_finite():
    place = torch.zeros(1, 3, requires_grad=True)
    axes = torch.eye(3)[None].requires_grad_()
    out = gather_light(place, axes, PointLights(torch.zeros(1, 3), torch.ones(1, 1)))
    out.sum().backward()
    assert torch.isfinite(out).all() and torch.isfinite(place.grad).all() and torch.isfinite(axes.grad).all()
    assert out[0, 2, 0, 0].item() == pytest.approx(1 / SMALLEST_DISTANCE2_M2 / (4 * math.pi), rel=1e-5)


def test_no_light_gives_zero():
    out = gather_light(
        torch.zeros(4, 3), torch.eye(3).expand(4, 3, 3), PointLights(torch.zeros(0, 3), torch.zeros(0, 1))
    )
    assert out.shape == (4, 3, DEGREES, 1) and (out == 0).all()


@pytest.mark.parametrize("degrees", [2, 3, 5, 9])
def test_fewer_degrees_are_the_first_of_all_forward_and_backward(degrees):
    """The twin in float64 gathers all nine; of these the first are differentiated."""
    place, axes, lights, intensity = random_scene(40, 6, 3, seed=4)
    inputs = [tensor.clone().requires_grad_() for tensor in (place, axes)]
    twins = [tensor.double().requires_grad_() for tensor in (place, axes)]
    found = gather_light(*inputs, PointLights(lights, intensity), degrees=degrees)
    expected = gather_light_reference(*twins, lights.double(), intensity.double())[:, :, :degrees]
    assert found.shape[2] == degrees
    assert (found - expected).abs().max() < FLOAT32_SUM
    cotangent = torch.randn(found.shape, generator=torch.Generator().manual_seed(1))
    found.backward(cotangent)
    expected.backward(cotangent.double())
    for one, twin in zip(inputs, twins, strict=True):
        assert (one.grad - twin.grad).norm() / twin.grad.norm() < 1e-5
