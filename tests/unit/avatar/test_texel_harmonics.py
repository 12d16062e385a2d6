"""The row "EyeNeRF": its network starts at no light, knows no place in the world, and learns a highlight."""

import math

import pytest
import torch
from scipy.spatial.transform import Rotation

from pipeline.avatar.networks.texel_harmonics import TexelHarmonics
from pipeline.avatar.texels.posed_texels import PosedTexels
from pipeline.lighting.environment_sh import spherical_harmonics
from pipeline.lighting.lobes import unit

TEXELS, CODE = 300, 4
SHARPNESS, RATE, STEPS = 12.0, 2e-2, 250
ROUNDING = 1e-5


def posed_with(frames, generator):
    points = torch.randn(TEXELS, 3, generator=generator)
    return PosedTexels(points, frames, torch.zeros(TEXELS, 4))


def turned_frames(seed):
    return torch.as_tensor(Rotation.random(TEXELS, rng=seed).as_matrix(), dtype=torch.float32)


def above(generator):
    """Directions over the tangent plane, in the tangent frame."""
    directions = unit(torch.randn(TEXELS, 3, generator=generator))
    return torch.cat([directions[:, :2], directions[:, 2:].abs()], 1)


def test_a_new_network_gives_no_light_and_has_slopes():
    torch.manual_seed(0)
    network, frames = TexelHarmonics(TEXELS, CODE), turned_frames(0)
    found = network(torch.ones(CODE), posed_with(frames, torch.Generator().manual_seed(1)), torch.ones(3))
    assert found.shape == (TEXELS, 81) and (found == 0).all()
    found.square().sum().backward()  # a slope of zero at zero
    network.zero_grad()
    network(torch.ones(CODE), posed_with(frames, torch.Generator().manual_seed(1)), torch.ones(3)).sum().backward()
    assert network.tables.grad.abs().max() > 0


def test_a_scene_that_is_turned_as_a_whole_shines_alike():
    torch.manual_seed(0)
    network = TexelHarmonics(TEXELS, CODE)
    torch.nn.init.normal_(network.tables)
    torch.nn.init.normal_(network.features)
    posed, center = posed_with(turned_frames(0), torch.Generator().manual_seed(1)), torch.tensor([0.3, 5.0, 1.0])
    turn = torch.as_tensor(Rotation.random(rng=3).as_matrix(), dtype=torch.float32)
    turned = PosedTexels(posed.points @ turn.T, turn @ posed.tangent_frames, posed.quaternions)
    one, other = (network(torch.zeros(CODE), scene, eye) for scene, eye in ((posed, center), (turned, turn @ center)))
    assert (one - other).abs().max() < ROUNDING * one.abs().max() * 81


def test_a_highlight_can_be_learned_under_drawn_lights():
    """A lobe of the mirror direction, which degree 8 can hold, of texels that shine by different amounts."""
    torch.manual_seed(0)
    generator = torch.Generator().manual_seed(1)
    network, strength = TexelHarmonics(TEXELS, CODE), 0.5 + torch.rand(TEXELS, generator=generator)
    frames, optimizer = turned_frames(0), torch.optim.Adam(network.parameters(), lr=RATE)
    left = []
    for step in range(STEPS):
        for group in optimizer.param_groups:
            group["lr"] = RATE * 0.05 ** (step / STEPS)
        toward, light = above(generator), above(generator)
        world = (frames @ toward[..., None])[..., 0]
        posed = PosedTexels(-world, frames, torch.zeros(TEXELS, 4))
        mirrored = toward * torch.tensor([-1.0, -1.0, 1.0])
        seen = strength * torch.exp(SHARPNESS * ((mirrored * light).sum(-1) - 1))
        told = (network(torch.zeros(CODE), posed, torch.zeros(3)) * spherical_harmonics(light)).sum(-1)
        loss = (told - seen).abs().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        left.append(float((told - seen).detach().square().sum() / seen.square().sum()))
    # What is asked of the row in a picture: two decibels, 37 % of the squares.
    assert sum(left[-20:]) / 20 < math.pow(10, -0.2)
    assert left[0] == pytest.approx(1)
