"""Shading: Lambert in closed form, the glint where the mirror law puts it, the shadow network's start."""

import math

import numpy as np
import pytest
import torch
from scipy.optimize import least_squares
from scipy.special import eval_legendre, factorial, lpmv

from pipeline.avatar.appearance.glossy import GlossySamples, grazing_gain, shade_halfway, shade_specular
from pipeline.avatar.appearance.transfer import COLOR_DEGREES, UNTURNED_SCALE, shade_diffuse
from pipeline.avatar.networks.shadow_net import SHARE_CEILING, SHARE_FLOOR, ShadowNet
from pipeline.lighting.lobes import angular_gaussian, mirror_direction, unit
from pipeline.lighting.microfacet import gather_reflections_reference
from pipeline.lighting.point_lights import PointLights
from pipeline.lighting.zonal import clamped_cosine_coefficients, gather_light
from tests.support.avatars.sheet import make_sheet

TRUNCATION = 0.06
"""Degree 8 of the clamped cosine is within 0.02 of it (worst near the horizon, up to 0.06)."""


@pytest.mark.parametrize("angle", [0.0, 0.6, 1.2])
def test_lambertian_transfer_gives_albedo_over_pi_cosine_over_distance2(angle):
    distance = 2.0
    light = distance * torch.tensor([[math.sin(angle), 0.0, math.cos(angle)]])
    gathered = gather_light(torch.zeros(1, 3), torch.eye(3)[None], PointLights(light, torch.tensor([[5.0, 3.0, 1.0]])))
    transfer = torch.zeros(1, 3, 9)
    transfer[:, 2] = torch.as_tensor(clamped_cosine_coefficients(), dtype=torch.float32)
    albedo = torch.tensor([[0.8, 0.5, 0.1]])
    color = transfer[:, :, :COLOR_DEGREES, None].repeat(1, 1, 1, 3)
    shaded = shade_diffuse(albedo, color, transfer[:, :, COLOR_DEGREES:], gathered)
    unit_response = albedo[0] * torch.tensor([5.0, 3.0, 1.0]) / math.pi / distance**2
    assert (shaded[0] / unit_response).tolist() == pytest.approx([math.cos(angle)] * 3, abs=TRUNCATION)


@pytest.mark.parametrize("shade", [shade_specular, shade_halfway])
def test_glint_sits_where_the_mirror_law_puts_it(shade):
    """Camera and light at equal heights over a plane: the brightest point lies midway between their feet."""
    x = torch.linspace(-1, 1, 401)
    points = torch.stack([x, torch.zeros_like(x), torch.zeros_like(x)], -1)
    normals = torch.tensor([0.0, 0, 1.0]).expand(401, 3)
    camera, light = torch.tensor([-0.7, 0, 1.0]), torch.tensor([[0.3, 0, 1.0]])
    ones = torch.ones(401)
    samples = GlossySamples(points, normals, 0.02 * ones, ones)
    radiance = shade(samples, camera, PointLights(light, torch.ones(1, 1)))
    assert x[radiance[:, 0].argmax()].item() == pytest.approx(-0.2, abs=0.011)


SCHLICK_ERROR = 0.036
"""Of the reflectance of glass, index 1.5: the most that Schlick's polynomial differs by, at 85 degrees."""


def test_lobe_grows_towards_grazing_views_as_glass_does():
    """Against Fresnel's equations for an index of 1.5, over their value at normal incidence, 0.04."""
    angle = torch.linspace(0, math.pi / 2, 91, dtype=torch.float64)
    cos_i, cos_t = angle.cos(), (1 - (angle.sin() / 1.5) ** 2).sqrt()
    across = ((cos_i - 1.5 * cos_t) / (cos_i + 1.5 * cos_t)) ** 2
    along = ((cos_t - 1.5 * cos_i) / (cos_t + 1.5 * cos_i)) ** 2
    to_camera = torch.stack([angle.sin(), torch.zeros_like(angle), cos_i], -1).requires_grad_()
    gain = grazing_gain(torch.tensor([0.0, 0, 1.0], dtype=torch.float64).expand(91, 3), to_camera)
    assert ((gain * 0.04 - (across + along) / 2).abs() < SCHLICK_ERROR).all()
    assert [gain[0].item(), gain[-1].item()] == pytest.approx([1, 25])
    gain.sum().backward()
    assert torch.isfinite(to_camera.grad).all()


def test_rough_gloss_is_a_lobe_of_the_half_vector_not_of_the_mirror_direction():
    """What GGX of width 0.3 reflects of lights from everywhere towards a camera that sees a ball, fitted by each lobe
    with the two numbers it has: one leaves 11 % of the gloss, the papers' 64 %."""
    generator = np.random.default_rng(0)
    radius, around = np.sqrt(generator.random(4000)), 2 * np.pi * generator.random(4000)
    normals = np.stack([radius * np.cos(around), radius * np.sin(around), np.sqrt(1 - radius**2)], 1)
    normals, to_camera = torch.tensor(normals), torch.tensor([[0.0, 0, 1.0]], dtype=torch.float64).expand(4000, 3)
    lights = unit(torch.tensor(generator.normal(size=(4000, 3))))

    def reflected(normal, light, width, gaussian):
        return gather_reflections_reference(
            torch.zeros(1, 3), normal[None], to_camera[:1], width[None], light[None], torch.ones(1, 1).double(),
            gaussian=gaussian,
        )[0, 0]  # fmt: skip

    each = torch.vmap(reflected, (0, 0, None, None))
    gloss = each(normals, lights, torch.tensor(0.3, dtype=torch.float64), False).numpy()
    mirrored = mirror_direction(normals, to_camera)
    grazing = grazing_gain(normals, to_camera).numpy()
    lobes = {
        "half": lambda width: each(normals, lights, torch.tensor(width / math.sqrt(2)), True).numpy(),
        "mirror": lambda width: grazing * angular_gaussian(lights, mirrored, torch.tensor(width)).numpy(),
    }

    def shown(radiance):  # by an image, of a light that makes white skin a little too bright
        return np.minimum(4 * radiance, 1)

    left = {}
    for name, lobe in lobes.items():
        fit = least_squares(lambda x, lobe=lobe: shown(x[0] * lobe(x[1])) - shown(gloss), [0.1, 0.2], bounds=(1e-3, 2))
        left[name] = math.sqrt((fit.fun**2).mean() / (shown(gloss) ** 2).mean())
    assert left["half"] < 0.2 < 0.5 < left["mirror"]


@pytest.mark.parametrize("shade", [shade_specular, shade_halfway])
def test_specular_is_finite_in_the_mirror_direction_at_the_smallest_roughness(shade):
    point = torch.zeros(1, 3)
    normal = torch.tensor([[0.0, 0, 1.0]], requires_grad=True)
    sigma = torch.full((1,), 0.01, requires_grad=True)
    above = torch.tensor([0.0, 0, 2.0])
    samples = GlossySamples(point, normal, sigma, torch.ones(1))
    shade(samples, above, PointLights(above[None], torch.ones(1, 1))).sum().backward()
    assert all(torch.isfinite(tensor.grad).all() for tensor in (normal, sigma))


def test_shadow_net_starts_at_the_unshadowed_share():
    net = ShadowNet(make_sheet(8), width=4)
    share = torch.linspace(0, 1, 64)
    shadow = net(torch.full((64,), 0.5), share)
    assert torch.allclose(shadow, share.clamp(SHARE_FLOOR, SHARE_CEILING), atol=1e-6)


def test_scale_of_unturned_coefficients_is_a_ratio_of_means_and_no_choice():
    """Mean absolute values of what the two kinds of transfer are multiplied with, over light directions, from SciPy's
    Legendre functions: Y_lm up to degree 8, and (2 l + 1) / (4 pi) P_l along three axes. The mean of 40,000 directions
    is good to 0.2 %."""
    directions = np.random.default_rng(0).normal(size=(40_000, 3))
    x, y, z = (directions / np.linalg.norm(directions, axis=1, keepdims=True)).T
    around, unturned, zonal = np.arctan2(y, x), 0.0, 0.0
    for degree in range(9):
        zonal += sum(np.abs((2 * degree + 1) / (4 * math.pi) * eval_legendre(degree, t)).mean() for t in (x, y, z))
        for order in range(degree + 1):
            share = factorial(degree - order) / factorial(degree + order)
            size = np.sqrt((2 * degree + 1) / (4 * math.pi) * share) * np.abs(lpmv(order, degree, z))
            turns = (np.cos(order * around), np.sin(order * around)) if order else (np.ones_like(z) / math.sqrt(2),)
            unturned += sum((math.sqrt(2) * size * np.abs(turn)).mean() for turn in turns)
    assert unturned == pytest.approx(18.0, rel=0.01) and zonal == pytest.approx(5.25, rel=0.01)
    assert pytest.approx(unturned / zonal, rel=0.01) == UNTURNED_SCALE
