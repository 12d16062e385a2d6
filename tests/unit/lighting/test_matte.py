"""Matte light that a point sees, bare and under a coat: against plain torch, the cosine law and Mitsuba."""

import numpy as np
import pytest
import torch

from pipeline.lighting import device_sums
from pipeline.lighting.matte import (
    arriving_vectors,
    arriving_vectors_in_torch,
    coat_passes,
    grazing_irradiance,
    grazing_irradiance_in_torch,
)
from pipeline.lighting.point_lights import PointLights
from tests.support.lighting.seen_lights import COUNT, LIGHTS, packed, points_under_lights


@pytest.fixture
def scene():
    points, normals, _, _, lights, power, seen = points_under_lights()
    return points, normals, lights, power, seen


def cosines(points, normals, lights):
    offset = lights - points[:, None]
    return (offset * normals[:, None]).sum(-1) / offset.norm(dim=-1), offset.norm(dim=-1)


def test_irradiance_is_the_cosine_law_over_seen_lights(scene):
    points, normals, lights, power, seen = scene
    found = (arriving_vectors(points, normals, PointLights(lights, power, packed(seen))) * normals[:, None]).sum(-1)
    cosine, distance = cosines(points, normals, lights)
    assert torch.allclose(found, (cosine.clamp_min(0) / distance**2 * seen.T) @ power, atol=1e-5)


def test_what_a_coat_keeps_back_and_its_slope_are_those_of_doubles(scene):
    points, normals, lights, power, seen = scene
    normals.requires_grad_()
    found = grazing_irradiance(points, normals, PointLights(lights, power, packed(seen)))
    exact = normals.detach().double().requires_grad_()
    cosine, distance = cosines(points.double(), exact, lights.double())
    cosine = cosine.clamp_min(0)
    expected = (cosine * (1 - cosine) ** 2.5 / distance**2 * seen.T) @ power.double()
    assert expected.max() > 0.02
    assert torch.allclose(found.double(), expected, rtol=1e-4, atol=1e-7)
    weight = torch.linspace(-1, 1, found.numel()).reshape(found.shape)
    (found * weight).sum().backward()
    (expected * weight).sum().backward()
    assert torch.allclose(normals.grad.double(), exact.grad, rtol=1e-3, atol=1e-4 * exact.grad.abs().max().item())


def test_without_the_kernels_it_is_the_same(scene, monkeypatch):
    """In pieces of five points; what every light reaches needs no mask."""
    monkeypatch.setattr(device_sums, "PAIRS_AT_ONCE", 5 * LIGHTS)
    points, normals, lights, power, seen = scene
    for bits in (packed(seen), np.full((LIGHTS, COUNT // 8), 255, np.uint8)):
        few = (points, normals, PointLights(lights, power, bits))
        assert torch.allclose(arriving_vectors(*few), arriving_vectors_in_torch(*few), rtol=1e-5, atol=1e-6)
        assert torch.allclose(grazing_irradiance(*few), grazing_irradiance_in_torch(*few), rtol=1e-4, atol=1e-6)


def test_a_light_straight_above_and_one_at_the_horizon_have_finite_slopes():
    normals = torch.tensor([[0.0, 0, 1]]).requires_grad_()
    lights = PointLights(torch.tensor([[0.0, 0, 2], [2, 0, 0], [2, 0, 1e-6]]), torch.ones(3, 1))
    grazing_irradiance(torch.zeros(1, 3), normals, lights).sum().backward()
    assert torch.isfinite(normals.grad).all()


def test_a_rough_dielectric_lets_as_much_through():
    """Mitsuba's roughplastic without its gloss: 0.02 off at most, from a twentieth to straight above."""
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    bsdf = mi.load_dict({
        "type": "roughplastic", "distribution": "ggx", "alpha": 0.3, "int_ior": 1.5,
        "diffuse_reflectance": {"type": "rgb", "value": 0.5}, "specular_reflectance": {"type": "rgb", "value": 0.0},
    })  # fmt: skip

    def passes(cosine):
        hit = mi.SurfaceInteraction3f()
        hit.wi = mi.Vector3f(0, 0, 1)
        return bsdf.eval(mi.BSDFContext(), hit, mi.Vector3f(np.sqrt(1 - cosine**2), 0, cosine))[0] / cosine

    at = np.linspace(0.05, 1, 20)
    true = np.array([passes(cosine) for cosine in at]) / passes(1.0)
    assert true[0] < 0.75
    assert np.abs(coat_passes(torch.as_tensor(at), torch.tensor(0.33)).numpy() - true).max() < 0.02
