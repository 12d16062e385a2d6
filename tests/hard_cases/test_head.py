"""The head avatar where its numbers are at their limits, in float32 against mpmath or closed forms."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
import torch

from pipeline.avatar.appearance.glossy import GlossySamples, shade_specular
from pipeline.avatar.appearance.penalties import ROUGHNESS_BOUNDS, negative
from pipeline.avatar.appearance.transfer import UNTURNED_SCALE, shade_harmonics, start_harmonics
from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.frames.prepared import LARGEST_LOG_VARIANCE, Latent
from pipeline.avatar.model import Avatar
from pipeline.avatar.networks.expression_vae import standard_divergence
from pipeline.avatar.networks.head_networks import LARGEST_FACTOR
from pipeline.avatar.spec.planned import resolve_spec
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.avatar.training.checkpoint import camera_view
from pipeline.config.train_avatar import TrainAvatar
from pipeline.lighting.environment_sh import spherical_harmonics
from pipeline.lighting.lobes import LOBE_CONSTANT, angle_between, cosine_gaussian, unit
from pipeline.lighting.point_lights import PointLights
from pipeline.lighting.zonal import DEGREES, clamped_cosine_coefficients
from tests.support.avatars.sheet import make_frame, make_image, make_sheet
from tests.support.results.hard_case import HardCase, worst

FLOAT32 = 5e-7
"""A dozen operations of float32."""

SUM_OF_81 = 5e-6
"""81 products of harmonics, each good to a few roundings by its recursion, added in float32."""

X, Z = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
SMALLEST = ROUGHNESS_BOUNDS[0]


def exact_divergence(mean: float, log_variance: float) -> mpmath.mpf:
    """Of one number, with the variance along its tangent above the largest."""
    mean, given, largest = (mpmath.mpf(x) for x in (mean, log_variance, LARGEST_LOG_VARIANCE))
    low = min(given, largest)
    return (mean**2 + mpmath.exp(low) * (1 + given - low) - given - 1) / 2


STANDARD_NORMAL = torch.distributions.Normal(0.0, 1.0)


@pytest.mark.parametrize("log_variance", [-1e30, -1e4, -100.0, -1e-3, 0.0, 1.0, 19.0, 21.0, 100.0, 1e4])
@pytest.mark.parametrize("mean", [0.0, 3.0])
def test_divergence_from_no_variance_to_far_too_much(case: HardCase, mean: float, log_variance: float) -> None:
    """Zero variance is infinitely far from a standard normal, at the slope -1/2 of its log: never NaN on the way."""
    inputs = [torch.tensor([x], requires_grad=True) for x in (mean, log_variance)]
    latent = Latent(*inputs)
    slopes = torch.autograd.grad(standard_divergence(latent), inputs)
    at = [x.item() for x in inputs]
    expected = exact_divergence(*at)
    growth = mpmath.exp(min(at[1], LARGEST_LOG_VARIANCE))
    by_variance = (growth - 1) / 2
    gradient = max(worst(slopes[0], [at[0]], max(1, abs(at[0]))), worst(slopes[1], [by_variance], max(1, by_variance)))
    case.check(worst(standard_divergence(latent), expected, max(1, abs(expected))), FLOAT32, gradient, FLOAT32)
    if log_variance <= -100:  # the variance has few digits, or none
        deviation = (0.5 * inputs[1].detach()).exp()
        laws = torch.distributions.Normal(inputs[0].detach(), deviation, validate_args=False), STANDARD_NORMAL
        case.naive_fails(worst(torch.distributions.kl_divergence(*laws), expected, max(1, abs(expected))))
    if log_variance >= 100:
        mu, log = (x.detach() for x in inputs)
        naive = 0.5 * (mu**2 + log.exp() - log - 1)
        case.naive_fails(worst(naive, expected, max(1, abs(expected))))


@pytest.mark.parametrize("log_variance", [-math.inf, -1e4, 100.0, 1e30])
def test_a_code_is_drawn_whatever_its_variance(case: HardCase, log_variance: float) -> None:
    """Without variance it is the mean; with far too much, it is finite."""
    mean, log = torch.tensor([0.7], requires_grad=True), torch.tensor([log_variance], requires_grad=True)
    sample = Latent(mean, log).sample(torch.tensor([1.5]))
    slopes = torch.autograd.grad(sample.sum(), (mean, log))
    deviation = math.exp(0.5 * min(log_variance, LARGEST_LOG_VARIANCE))
    expected = 0.7 + 1.5 * deviation
    finite = 0.0 if all(torch.isfinite(slope).all() for slope in slopes) else math.nan
    case.check(worst(sample, [expected], expected), FLOAT32, worst(slopes[0], [1.0]) + finite, FLOAT32)
    if log_variance > 0:
        case.naive_fails(worst(torch.tensor(0.7) + 1.5 * (0.5 * log.detach()).exp(), [expected], expected))


SETTINGS = TrainAvatar(avatar="head", deferred="off", code_size=4, decoder_channels=(8, 4), pose_points=4)


@pytest.mark.parametrize("anchors", ["tracked", "decoded"])
@pytest.mark.parametrize("distance", [1e2, 1e4, 1e8])
def test_latent_far_outside_the_training_set(case: HardCase, anchors: str, distance: float) -> None:
    """A new head whose decoders answer a code of length 1 by about 1: codes of any length give Gaussians of some size,
    and a picture that is finite, with finite slopes."""
    atlas = make_sheet(8)
    torch.manual_seed(0)
    settings = SETTINGS.model_copy(update={"anchors": anchors})
    avatar = Avatar(atlas, texel_spacing(atlas), resolve_spec(settings, {"near_field", "specular"}))
    for name, parameter in avatar.networks.named_parameters():
        if name.endswith("original0"):
            torch.nn.init.ones_(parameter)  # output layers start at zero
    frame = make_frame(atlas, np.array([[0.5, 0.3, 1.5]]), np.full((1, 3), 3.0))
    image = make_image(frame, np.array([0.7, 0.4, 0.2]))
    code = distance * unit(torch.tensor([[1.0, -2.0, 0.5]]))[0]
    code = torch.cat([code, code.new_zeros(1)]).requires_grad_()
    prepared = avatar.prepare(FrameInputs(atlas, frame), code=code)
    picture = avatar.view(prepared, camera_view(image)).rgb
    slope = torch.autograd.grad(picture.sum(), code, allow_unused=True)[0]
    not_finite = sum(int((~torch.isfinite(tensor)).sum()) for tensor in (picture, slope))
    ratio = (prepared.gaussians.scales.log() - avatar.log_scale).abs().max().item()
    excess = max(0.0, ratio / math.log(LARGEST_FACTOR) - 1)
    case.check(excess if not not_finite else math.nan, 1e-5, 0.0 if not not_finite else math.nan, 0)
    unbounded = avatar.networks.decoder.decoder(code)[:, 7:10]  # log scales follow offset and rotation
    case.naive_fails(worst((avatar.log_scale + unbounded).exp(), prepared.gaussians.scales, 1.0))


def exact_cosine_gaussian(p: list, q: list, sigma: float) -> mpmath.mpf:
    cosine = sum(a * b for a, b in zip(p, q, strict=True))
    return mpmath.mpf(LOBE_CONSTANT) / sigma * mpmath.exp((cosine - 1) / mpmath.mpf(sigma) ** 2)


@pytest.mark.parametrize("sigma", ROUGHNESS_BOUNDS)
@pytest.mark.parametrize("angle", [0.0, 1e-4, 3e-4, 1e-2, math.pi / 2, math.pi])
def test_cosine_gaussian_from_its_centre_to_its_border(case: HardCase, angle: float, sigma: float) -> None:
    """Against the usual form of exactly unit vectors; float32 rounds p by up to 6e-8, which is no error of the lobe's:
    the exact one is asked at the direction of the rounded vector."""
    with mpmath.workdps(40):
        p = torch.tensor([math.cos(angle), math.sin(angle), 0.0], requires_grad=True)
        width = torch.tensor(sigma, requires_grad=True)
        value = cosine_gaussian(p, torch.tensor(X), width)
        by_p, by_sigma = torch.autograd.grad(value, (p, width))
        length = mpmath.sqrt(sum(mpmath.mpf(x.item()) ** 2 for x in p.detach()))
        direction = [mpmath.mpf(x.item()) / length for x in p.detach()]
        at = mpmath.mpf(width.item())
        expected = exact_cosine_gaussian(direction, [1, 0, 0], at)
        # Across p, the slope of the usual form, lambda q, and that of -|p - q|^2 / 2 are the same.
        across = [expected / at**2 * ((i == 0) - direction[0] * direction[i]) for i in range(3)]
        along = sum(a.item() * b for a, b in zip(by_p, direction, strict=True))
        found = [a.item() - along * b for a, b in zip(by_p, direction, strict=True)]
        slope = mpmath.diff(lambda s: exact_cosine_gaussian(direction, [1, 0, 0], s), at)
        peak = LOBE_CONSTANT / sigma
        # What is left is the length of p, 1 to 6e-8: (1 - |p|)^2 lambda / 2, and its slope.
        bound = FLOAT32 + 2 * (6e-8 / sigma) ** 2 + 2 * 6e-8 * angle / sigma**2
        errors = worst(found, across, peak / sigma), worst(by_sigma, [slope], peak / sigma)
        case.check(worst(value, expected, peak), bound, max(errors), 4 * bound)
        if sigma == SMALLEST and 0 < angle < 1e-3:
            usual = LOBE_CONSTANT / width * torch.exp(((p * torch.tensor(X)).sum() - 1) / width**2)
            case.naive_fails(worst(usual, expected, peak))


@pytest.mark.parametrize("normal", [Z, X, tuple(unit(torch.tensor([0.3, -0.5, 0.8])).tolist())])
def test_light_behind_the_head(case: HardCase, normal: tuple) -> None:
    """Lambert up to degree 8 under one light straight behind: sum of z_l (2 l + 1) / (4 pi) P_l(-1), not quite zero and
    mostly below it, where the loss of negative colour has a finite slope."""
    n = torch.tensor([normal])
    color, mono = (tensor.requires_grad_() for tensor in start_harmonics(n))
    light = spherical_harmonics(-n)[..., None]
    shade = shade_harmonics(torch.ones(1, 3), color, mono, light)
    z = clamped_cosine_coefficients()
    series = sum(mpmath.mpf(z[k]) * (2 * k + 1) / (4 * mpmath.pi) * (-1) ** k for k in range(DEGREES))
    facing = sum(mpmath.mpf(z[k]) * (2 * k + 1) / (4 * mpmath.pi) for k in range(DEGREES))
    slopes = torch.autograd.grad(negative(shade), (color, mono))
    # d/dz of min(c, 0)^2, mean over three colours: 2 c / 3 Y; c is `series` where that is below zero.
    from_behind = 2 * min(series, 0) * light[0, :, 0].double().numpy().astype(object)
    expected = np.concatenate([np.repeat(from_behind[:16], 3) / 3, from_behind[16:]]) / mpmath.mpf(UNTURNED_SCALE)
    found = torch.cat([slopes[0].flatten(), slopes[1].flatten()])
    case.check(worst(shade, [[series] * 3], float(facing)), SUM_OF_81, worst(found, expected, 1.0), SUM_OF_81)


@pytest.mark.parametrize("tilt", [0.0, 0.5, 1.3])
def test_light_exactly_in_the_mirror_direction_at_the_smallest_roughness(case: HardCase, tilt: float) -> None:
    """The glint at its brightest: v F I / d^2 C / sigma, level in the normal, and -1 / sigma of itself in sigma."""
    place, camera = torch.zeros(1, 3), 2.0 * torch.tensor([math.sin(tilt), 0.0, math.cos(tilt)])
    light = torch.tensor([[-3.0 * math.sin(tilt), 0.0, 3.0 * math.cos(tilt)]])
    normal = torch.tensor([Z], requires_grad=True)
    sigma = torch.tensor([SMALLEST], requires_grad=True)
    samples = GlossySamples(place, normal, sigma, torch.tensor([0.5]))
    glint = shade_specular(samples, camera, PointLights(light, torch.tensor([[7.0]])))
    by_normal, by_sigma = torch.autograd.grad(glint.sum(), (normal, sigma))
    width, cosine = mpmath.mpf(sigma.item()), mpmath.cos(mpmath.mpf(tilt))
    fresnel = 1 + (1 / mpmath.mpf(0.04) - 1) * (1 - cosine) ** 5
    expected = mpmath.mpf(0.5) * fresnel * 7 / 9 * mpmath.mpf(LOBE_CONSTANT) / width
    # Rounded places leave the light 1e-7 rad off the mirror direction: (1e-7 / sigma)^2 of the value, 1e-7 / sigma of
    # the steepest slope.
    bound = 4 * FLOAT32
    across = by_normal[0, 1].abs().item() / (float(expected) / SMALLEST)
    errors = worst(by_sigma, [-expected / width], float(expected / width)), across
    case.check(worst(glint, [[expected]], float(expected)), bound, max(errors), bound)
    p, q = unit(light[0]), torch.tensor([-math.sin(tilt), 0.0, math.cos(tilt)]).requires_grad_()
    naive = torch.autograd.grad(torch.acos((p * unit(q)).sum().clamp(max=1.0)), q)[0]
    exact = torch.autograd.grad(angle_between(p, unit(q)), q)[0]
    if not torch.isfinite(naive).all():
        case.naive_fails(worst(naive, exact), "gradient")
