"""Distant lights by Legendre polynomials and by spherical harmonics: the same light, and the faster form of the two."""

import pytest
import torch

from pipeline.lighting import distant_light
from pipeline.lighting.distant_light import HARMONICS_FROM, as_distant, gather_by_legendre, gather_distant
from pipeline.lighting.environment_sh import gather_environment
from pipeline.lighting.lobes import unit
from pipeline.lighting.zonal import gather_light_reference

FLOAT32_SUM = 1e-5
"""Relative to the largest: 81 terms of a band, or a recurrence of 8 steps, each off by half an ulp (6e-8), and sums
over 100 lights."""


def distant_scene(points, lights, channels):
    generator = torch.Generator().manual_seed(0)
    axes = torch.linalg.qr(torch.randn(points, 3, 3, generator=generator))[0].contiguous()
    directions = unit(torch.randn(lights, 3, generator=generator))
    return axes, directions, torch.rand(lights, channels, generator=generator)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("lights", [1, 7, 100])
def test_both_forms_are_the_sum_over_lights_in_float64_forward_and_backward(lights, channels):
    axes, directions, irradiances = distant_scene(50, lights, channels)
    twin = axes.double().requires_grad_()
    expected = gather_light_reference(
        torch.zeros(50, 3, dtype=torch.float64), twin, directions.double(), irradiances.double()
    )
    cotangent = torch.randn(expected.shape, generator=torch.Generator().manual_seed(1))
    expected.backward(cotangent.double())
    for gather in (gather_by_legendre, by_harmonics):
        tried = axes.clone().requires_grad_()
        found = gather(tried, directions, irradiances)
        assert (found - expected).abs().max() < FLOAT32_SUM * expected.abs().max()
        found.backward(cotangent)
        turning, turning_twin = across(tried.grad, axes), across(twin.grad, twin)
        assert (turning - turning_twin).abs().max() < FLOAT32_SUM * turning_twin.abs().max()


def across(gradient, axes):
    """Without the parts along the axes: there the forms differ, and no rotation goes there."""
    return gradient - axes * (gradient * axes).sum(1, keepdim=True)


def by_harmonics(axes, directions, irradiances):
    return gather_environment(axes, distant_light.project_lights(directions, irradiances))


def test_few_lights_go_by_polynomials_and_many_by_harmonics(monkeypatch):
    taken = []
    for name in ("gather_by_legendre", "gather_environment"):
        original = getattr(distant_light, name)
        monkeypatch.setattr(distant_light, name, lambda *a, o=original, n=name: taken.append(n) or o(*a))
    for lights in (1, HARMONICS_FROM - 1, HARMONICS_FROM, 4 * HARMONICS_FROM):
        gather_distant(*distant_scene(5, lights, 1))
    assert taken == ["gather_by_legendre"] * 2 + ["gather_environment"] * 2


def test_no_light_and_a_light_at_the_centre_are_finite():
    axes = torch.eye(3)[None]
    assert (gather_distant(axes, *as_distant(torch.zeros(3), torch.zeros(0, 3), torch.zeros(0, 1))) == 0).all()
    assert gather_distant(axes, *as_distant(torch.zeros(3), torch.zeros(1, 3), torch.ones(1, 1))).isfinite().all()


def test_far_lights_are_distant():
    """At 1000 m, over points within 1 m, direction and falloff change by 1e-3 and 2e-3; over degree 8, by 8e-3."""
    axes, directions, irradiances = distant_scene(30, 10, 3)
    points = torch.rand(30, 3, generator=torch.Generator().manual_seed(2)) - 0.5
    near = gather_light_reference(points.double(), axes.double(), 1e3 * directions.double(), 1e6 * irradiances.double())
    found = gather_distant(axes, *as_distant(points.mean(0), 1e3 * directions, 1e6 * irradiances))
    assert (found - near).abs().max() < 8e-3 * near.abs().max()
