"""Where the papers' printed forms have no value or no slope, and inputs of their networks that no training had."""

from __future__ import annotations

import math
from dataclasses import replace

import mpmath
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from pipeline.avatar.appearance.glossy import GlossySamples, shade_specular
from pipeline.avatar.appearance.lobes import SMALLEST_ROUGHNESS, AngularLobe
from pipeline.avatar.appearance.penalties import PRINTED_FLOOR, ROUGHNESS_BOUNDS, outside_as_printed
from pipeline.avatar.eyes.eye_decoders import EYE_SIDE, EyeDecoders, front_places
from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.intrinsic_layers import traced_shadow
from pipeline.avatar.networks.gaze_features import GazeFeatures
from pipeline.avatar.networks.shadow_net import ShadowNet
from pipeline.avatar.training.shape_losses import SCALE_BOUNDS_M
from pipeline.eyes.eye_shape import turn_to
from pipeline.lighting.environment_sh import spherical_harmonics, turned_light
from pipeline.lighting.lobes import LOBE_CONSTANT
from pipeline.lighting.point_lights import PointLights
from tests.support.avatars.eyeballs import EYES, LIGHTS, eye_atlas, gaze, make_avatar, make_frame
from tests.support.avatars.sheet import make_sheet
from tests.support.results.hard_case import HardCase, worst

FLOAT32 = 2e-6
"""Two dozen operations of float32 on numbers of about 1."""

CLOSED = {"nothing": [0.0, 0.0, 0.0], "not a number": [math.nan, math.nan, math.nan], "no end": [math.inf, 0.0, 0.0]}
"""Directions of a gaze behind closed lids."""


@pytest.mark.parametrize("value", [0.0, 1e-8, PRINTED_FLOOR, 5e-5, 1e-4, 2e-2])
def test_printed_bound(case: HardCase, value: float) -> None:
    """1 / max(v, 1e-7) below, its slope -1 / v^2 above the floor and 0 under it; finite everywhere."""
    low, high = SCALE_BOUNDS_M
    v = torch.tensor(value, requires_grad=True)
    loss = outside_as_printed(v, low, high)
    (slope,) = torch.autograd.grad(loss, v)
    exact = mpmath.mpf(v.item())
    if exact < mpmath.mpf(float(np.float32(low))):
        expected = 1 / max(exact, mpmath.mpf(PRINTED_FLOOR))
        by_v = -1 / exact**2 if exact >= np.float32(PRINTED_FLOOR) else mpmath.mpf(0)
    else:
        expected, by_v = max(exact - high, 0) ** 2, 2 * max(exact - high, 0)
    case.check(
        worst(loss, expected, float(max(expected, 1))), FLOAT32, worst(slope, by_v, float(max(abs(by_v), 1))), FLOAT32
    )
    if value < PRINTED_FLOOR:
        number = torch.tensor(value, requires_grad=True)
        (naive,) = torch.autograd.grad(torch.where(number < low, 1 / number, number), number)
        case.naive_fails(naive.abs(), "gradient")


@pytest.mark.parametrize("closed", CLOSED)
def test_gaze_behind_closed_lids_for_the_decoders_of_a_head(case: HardCase, closed: str) -> None:
    """It tells the decoders nothing: zeros, as where there is no eye; the other eye tells what it did."""
    torch.manual_seed(0)
    features = GazeFeatures(eye_atlas(), EYES)
    both, one = torch.tensor(np.stack([gaze(10, 5), gaze(10, 5)]), dtype=torch.float32), torch.tensor(CLOSED[closed])
    open_eyes, half = features(both), features(torch.stack([both[0], one]))
    rows = [slice(place, place + 2) for place in features.places[1]]
    left = [slice(place, place + 2) for place in features.places[0]]
    slopes = torch.autograd.grad(half.sum(), list(features.parameters()))
    case.check(worst(half[:, left[0], left[1]], open_eyes[:, left[0], left[1]].detach()), FLOAT32)
    case.check(
        worst(half[:, rows[0], rows[1]], torch.zeros(16, 2, 2)),
        0,
        float(not all(s.isfinite().all() for s in slopes)),
        0,
    )
    case.naive_fails(features.layers[1](one / one.norm()).detach().abs().max())


@pytest.mark.parametrize("closed", CLOSED)
def test_gaze_behind_closed_lids_for_the_decoders_of_eyes(case: HardCase, closed: str) -> None:
    """As of an eye that is not told where it looks."""
    decoders, _, opening = eye_decoders()
    looks = torch.tensor(np.stack([gaze(0, 0)] * 2), dtype=torch.float32)
    looks[1] = torch.tensor(CLOSED[closed])
    found = decoders.features(looks, torch.eye(3, 4), opening)
    expected = decoders.gaze[1].bias.detach()
    expected = torch.where(expected > 0, expected, 0.2 * expected).reshape(16, EYE_SIDE, EYE_SIDE)
    case.check(worst(found[1, :16], expected), FLOAT32)
    case.check(float(not found.isfinite().all()), 0)
    case.naive_fails(decoders.gaze[0](looks[1] / looks[1].norm()).detach().abs().max())


def eye_decoders() -> tuple[EyeDecoders, dict[str, torch.Tensor], torch.Tensor]:
    """Decoders of two eyes with noise on all weights, the parameters that they add to, and open lids."""
    avatar = make_avatar(eye_atlas(), EYES)
    own = {"log_scale": avatar.log_scale[avatar.eyes.chosen], "opacity": avatar.opacity[avatar.eyes.chosen]}
    torch.manual_seed(0)
    decoders = EyeDecoders(avatar.eyes.directions, avatar.eyes.eye, avatar.eyes.axes, own, (4,))
    with torch.no_grad():
        for parameter in decoders.parameters():
            parameter += 0.3 * torch.randn_like(parameter)
    return decoders, own, torch.ones(len(avatar.eyes.chosen))


@pytest.mark.parametrize("far", [1e2, 1e6])
def test_head_far_from_where_any_was_in_training(case: HardCase, far: float) -> None:
    """Scales of eyes become ten times larger or smaller at most, their albedo twenty times; all is finite."""
    decoders, _, opening = eye_decoders()
    motion = torch.cat([torch.eye(3), torch.tensor([[far], [-far], [far]])], 1)
    features = decoders.features(torch.tensor(np.stack([gaze(0, 0)] * 2), dtype=torch.float32), motion, opening)
    added = decoders.decode(features)
    gain, visibility = decoders.view(features, torch.tensor([[0.0, 0, 1], [0, 0, 1]]))
    slopes = torch.autograd.grad(added["log_scale"].sum() + gain.sum(), list(decoders.parameters()), allow_unused=True)
    beyond = max(added["log_scale"].abs().max().item() - math.log(10), gain.max().item() - math.exp(3), 0.0)
    finite = visibility.isfinite().all() and all(s.isfinite().all() for s in slopes if s is not None)
    case.check(beyond, 1e-5, float(not finite), 0)
    raw = torch.cat([decoder(own) for decoder, own in zip(decoders.fixed, features, strict=True)])
    case.naive_fails(raw.detach().abs().max() - math.log(10))


@pytest.mark.parametrize("angle", [0.0, 1e-7, math.pi / 2, math.pi])
def test_place_on_the_map_of_an_eye(case: HardCase, angle: float) -> None:
    """The middle where the eye looks, the border a right angle away and all that is behind it."""
    axis = torch.tensor([[0.0, 0.6, 0.8]])
    across = torch.tensor([[1.0, 0.0, 0.0]])
    place = front_places(math.cos(angle) * axis + math.sin(angle) * across, axis)
    expected = min(0.5 * angle / (math.pi / 2), 0.5)
    case.check(worst(np.linalg.norm(place - 0.5), expected, 1.0), FLOAT32)
    looks = math.cos(angle) * axis + math.sin(angle) * across
    aside = torch.stack([looks[0, 0], (looks[0, 1] * axis[0, 2] - looks[0, 2] * axis[0, 1])])
    if angle in (0.0, math.pi):  # by an azimuth, which has no value there, and without an end at the border
        naive = 0.5 * torch.acos((looks * axis).sum()) / (math.pi / 2) * aside / aside.norm()
        case.naive_fails(worst(naive.norm(), expected, 1.0))


@pytest.mark.parametrize("alpha", [1e-6, 1 / 255, 0.5])
def test_accumulated_roughness_of_a_pixel_that_is_hardly_covered(case: HardCase, alpha: float) -> None:
    """In the mirror direction, C / sigma of sigma = alpha 0.01, at least 0.001; and finite slopes."""
    lobe = object.__new__(AngularLobe)
    lobe.screen_maps = "accumulated"
    blended = torch.tensor([alpha * ROUGHNESS_BOUNDS[0]], requires_grad=True)
    normal = torch.tensor([[0.0, 0, 1.0]], requires_grad=True)
    above = torch.tensor([0.0, 0, 2.0])
    width = lobe.of_pixels(blended, torch.tensor([alpha]))
    samples = GlossySamples(torch.zeros(1, 3), normal, width, torch.ones(1))
    lights = PointLights(above[None], torch.ones(1, 1))
    lit = shade_specular(samples, above, lights, fresnel="none")
    slopes = torch.autograd.grad(lit.sum(), [blended, normal])
    sigma = max(alpha * ROUGHNESS_BOUNDS[0], SMALLEST_ROUGHNESS)
    expected = LOBE_CONSTANT / sigma / 4
    by_width = -expected / sigma if sigma > SMALLEST_ROUGHNESS else 0.0
    case.check(worst(lit, expected), 1e-5, worst(slopes[0], by_width), 1e-4)
    case.check(float(not slopes[1].isfinite().all()), 0)
    if sigma == SMALLEST_ROUGHNESS:
        thin = GlossySamples(torch.zeros(1, 3), normal.detach(), blended.detach(), torch.ones(1))
        case.naive_fails(worst(shade_specular(thin, above, lights, fresnel="none"), expected))


@pytest.mark.parametrize("share", [0.0, 1.0, 40.0])
def test_shadow_network_of_the_irradiance_alone(case: HardCase, share: float) -> None:
    """Of no light, of all, and of a single draw among forty: a factor in 0..1, and slopes; levels end at one texel."""
    torch.manual_seed(0)
    net = ShadowNet(make_sheet(8), 4, "irradiance", levels=9)
    factor = net(torch.full((64,), share), torch.full((64,), math.nan))
    slopes = torch.autograd.grad(factor.sum(), [net.last.bias, net.hidden[0].weight])
    outside = float((torch.relu(factor - 1).max() + torch.relu(-factor).max()).detach())
    case.check(outside, 0, float(not all(slope.isfinite().all() for slope in slopes)), 0)


def test_shadow_layer_of_texels_that_no_lamp_is_above(case: HardCase) -> None:
    """0 of 0 arrives: nothing is hidden, so the layer shows 1."""
    avatar = make_avatar(eye_atlas(), EYES, specular=False, shadow=True, shading="microfacet", visibility="traced")
    record = make_frame(eye_atlas(), gaze(0, 0), LIGHTS)
    record = replace(
        record, light_positions=np.array([[0.0, 0.0, -1.0]], np.float32), light_intensities=record.light_intensities[:1]
    )
    with torch.no_grad():
        frame = avatar.prepare(FrameInputs(eye_atlas(), record))
        shadow = traced_shadow(avatar, frame)
        away = (frame.surface.bent_normals[:, 2] > 0.3).numpy()
        dark = frame.shading.diffuse.sum(-1)
    case.check(worst(shadow[away], np.ones(away.sum())), 0)
    naive = (dark / (dark + 1e-8))[away]  # guarded, as it is usually written: black
    case.naive_fails(worst(naive, np.ones(len(naive))))


def test_no_turn_is_asked_of_a_gaze_that_is_none(case: HardCase) -> None:
    """The eyes themselves stay as they are at rest."""
    ahead = torch.tensor([[0.0, 0.0, 1.0]])
    case.check(worst(turn_to(ahead, torch.zeros(1, 3)), np.eye(3)[None]), FLOAT32)
    axis = torch.linalg.cross(ahead, torch.zeros(1, 3))
    case.naive_fails((axis / axis.norm()).abs().max())


@pytest.mark.parametrize("angle", [0.0, 1e-6, 1.0, math.pi])
def test_harmonics_of_one_bright_pixel_after_a_turn(case: HardCase, angle: float) -> None:
    """A map that is black but for one pixel: its harmonics turned are those of the turned direction."""
    turn = torch.as_tensor(Rotation.from_rotvec(angle * np.array([0.6, 0.0, 0.8])).as_matrix())
    direction = torch.tensor([[0.36, 0.48, 0.8]], dtype=torch.float64)
    power = torch.tensor([[1e4, 0.0, 1e-4]], dtype=torch.float64)
    found = turned_light((spherical_harmonics(direction).T @ power).float(), turn.float())
    expected = spherical_harmonics(direction @ turn.float().double().T).T @ power
    # Degree 8 has slopes of about 8 by the direction, which float32 rounds.
    case.check(worst(found, expected), 1e-6)
