"""The angular spherical Gaussian at its singular directions and the bounds of its width, in float32 against mpmath."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
import torch

from pipeline.avatar.appearance.penalties import ROUGHNESS_BOUNDS
from pipeline.lighting.lobes import LOBE_CONSTANT, SMALLEST_NORM, angle_between, angular_gaussian, unit
from pipeline.lighting.point_lights import PointLights
from pipeline.lighting.specular_lobes import gather_specular
from pipeline.lighting.zonal import SMALLEST_DISTANCE2_M2
from tests.support.naive.shading import naive_lobe_slope
from tests.support.results.hard_case import HardCase, worst

FLOAT32 = 5e-7
"""A dozen operations of float32 on the lobe's value over its peak, and on its slope over its steepest slope."""

X = (1.0, 0.0, 0.0)


def lobe(p: list, q: list, sigma: mpmath.mpf) -> mpmath.mpf:
    """RFGCA 13 of vectors of any length."""
    cross = [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]]
    angle = mpmath.atan2(mpmath.sqrt(sum(c * c for c in cross)), sum(a * b for a, b in zip(p, q, strict=True)))
    return mpmath.mpf(LOBE_CONSTANT) / sigma * mpmath.exp(-((angle / sigma) ** 2) / 2)


def check_lobe(case: HardCase, p: tuple, q: tuple, sigma: float) -> float:
    """Value over the peak, derivatives by p and by sigma over the steepest, all against mpmath.

    Returns:
        The error of the naive derivative by p.
    """
    inputs = [torch.tensor(values, requires_grad=True) for values in (p, sigma)]
    value = angular_gaussian(inputs[0], torch.tensor(q), inputs[1])
    by_p, by_sigma = torch.autograd.grad(value, inputs)
    exact_p, exact_q = ([mpmath.mpf(x) for x in torch.tensor(v).tolist()] for v in (p, q))
    exact = mpmath.mpf(inputs[1].item())
    steps = [[mpmath.mpf(0.5) ** 40 * (i == k) for k in range(3)] for i in range(3)]
    with mpmath.workdps(60):
        slopes = [
            (lobe([a + s for a, s in zip(exact_p, step, strict=True)], exact_q, exact)
             - lobe([a - s for a, s in zip(exact_p, step, strict=True)], exact_q, exact)) * mpmath.mpf(2) ** 39
            for step in steps
        ]  # fmt: skip
        slope_sigma = mpmath.diff(lambda s: lobe(exact_p, exact_q, s), exact)
    peak = LOBE_CONSTANT / sigma
    errors = worst(by_p, slopes, peak / sigma), worst(by_sigma, slope_sigma, peak / sigma)
    case.check(worst(value, lobe(exact_p, exact_q, exact), peak), FLOAT32, max(errors), FLOAT32)
    return worst(naive_lobe_slope(p, q, sigma), slopes, peak / sigma)


@pytest.mark.parametrize("sigma", ROUGHNESS_BOUNDS)
def test_p_equals_q(case: HardCase, sigma: float) -> None:
    check_lobe(case, X, X, sigma)
    case.naive_fails(worst(naive_lobe_slope(X, X, sigma), np.zeros(3)), "gradient")


@pytest.mark.parametrize("sigma", ROUGHNESS_BOUNDS)
def test_p_opposite_to_q(case: HardCase, sigma: float) -> None:
    """The angle has a kink there; the lobe is as good as zero, and so is its slope."""
    check_lobe(case, X, (-1.0, 0.0, 0.0), sigma)
    case.naive_fails(worst(naive_lobe_slope(X, (-1.0, 0.0, 0.0), sigma), np.zeros(3)), "gradient")


@pytest.mark.parametrize("angle", [1e-6, 1e-4, 1e-3])
@pytest.mark.parametrize("sigma", ROUGHNESS_BOUNDS)
def test_a_hair_beside_q(case: HardCase, angle: float, sigma: float) -> None:
    case.naive_fails(check_lobe(case, X, (1.0, angle, 0.0), sigma), "gradient")


def test_small_angles_keep_their_digits(case: HardCase) -> None:
    """At 3e-5 rad a cosine in float32 is one and nothing else."""
    p, q = torch.tensor(X), unit(torch.tensor((1.0, 3e-5, 0.0)))
    exact = mpmath.atan2(mpmath.mpf(q[1].item()), mpmath.mpf(q[0].item()))
    case.check(worst(angle_between(p, q), exact), 1e-5)
    case.naive_fails(worst(torch.acos((p * q).sum().clamp(-1, 1)), exact))


@pytest.mark.parametrize("sigmas", [0.5, 3.0])
@pytest.mark.parametrize("sigma", ROUGHNESS_BOUNDS)
def test_slope_of_the_flank_at_the_bounds_of_sigma(case: HardCase, sigmas: float, sigma: float) -> None:
    angle = sigmas * sigma
    naive = check_lobe(case, X, (math.cos(angle), math.sin(angle), 0.0), sigma)
    if sigma < 0.1:
        case.naive_fails(naive, "gradient")


@pytest.mark.parametrize("length", [0.0, 1e-6, 1e6])
def test_direction_of_a_vector_of_any_length(case: HardCase, length: float) -> None:
    vector = torch.tensor([2 * length, -length, 0.5 * length], requires_grad=True)
    norm = mpmath.sqrt(mpmath.mpf(21) / 4)
    expected = [x / norm if length else mpmath.mpf(0) for x in (2, -1, mpmath.mpf(0.5))]
    found = unit(vector)
    (slope,) = torch.autograd.grad(found[0], vector)
    # d n_x / d v = (e_x - n_x n) / |v|; at zero length |v| is bounded from below.
    least = norm * length or mpmath.mpf(SMALLEST_NORM)
    by_vector = [((i == 0) - expected[0] * expected[i]) / least for i in range(3)]
    case.check(worst(found, expected, 1.0), FLOAT32, worst(slope, by_vector), FLOAT32)
    if length == 0:
        case.naive_fails(worst(vector / vector.norm(), expected, 1.0))
    if length == 1e-6:
        case.naive_fails(worst(vector / (vector.norm() + 1e-8), expected, 1.0))  # guarded, as it is usually written


@pytest.mark.parametrize("sigma", ROUGHNESS_BOUNDS)
def test_light_exactly_in_the_mirror_direction(case: HardCase, sigma: float) -> None:
    """The peak of the glint is C / sigma I / d^2: no slope across it, and -1 / sigma of itself along sigma."""
    center, width = torch.tensor([X], requires_grad=True), torch.tensor([sigma], requires_grad=True)
    out = gather_specular(
        torch.zeros(1, 3), center, width, PointLights(torch.tensor([[2.5, 0, 0]]), torch.full((1, 1), 4.0))
    )
    by_center, by_width = torch.autograd.grad(out.sum(), (center, width))
    peak = 4.0 / 2.5**2 * LOBE_CONSTANT / width.item()
    slopes = max(worst(by_center[0, 1:], [0, 0], peak / sigma), worst(by_width, -peak / width.item()))
    case.check(worst(out, peak), FLOAT32, slopes, FLOAT32)
    case.naive_fails(worst(naive_lobe_slope(X, X, sigma)[1:], np.zeros(2)), "gradient")


def test_glint_of_a_light_on_the_point_itself(case: HardCase) -> None:
    """It has no direction: taken at the least distance, finite, and right about the falloff that it has."""
    center, width = torch.tensor([X], requires_grad=True), torch.tensor([0.25], requires_grad=True)
    place = torch.zeros(1, 3)
    out = gather_specular(place, center, width, PointLights(place, torch.ones(1, 1)))
    slopes = torch.autograd.grad(out.sum(), (center, width))
    # Direction zero: p . q = |p x q| = 0, which is 90 degrees for any q.
    exact = lobe([mpmath.mpf(0), mpmath.mpf(1), mpmath.mpf(0)], [mpmath.mpf(1), 0, 0], mpmath.mpf(0.25))
    by_width = exact * ((mpmath.pi / 2) ** 2 / mpmath.mpf(0.25) ** 3 - 4)
    scale = LOBE_CONSTANT / 0.25 / float(SMALLEST_DISTANCE2_M2)
    case.check(
        worst(out, exact / mpmath.mpf(float(SMALLEST_DISTANCE2_M2)), scale), FLOAT32,
        max(worst(slopes[0][0, 1:], [0, 0], 4 * scale),
            worst(slopes[1], by_width / mpmath.mpf(float(SMALLEST_DISTANCE2_M2)), 4 * scale)), FLOAT32,
    )  # fmt: skip
    naive = float(exact) / ((place - place).square().sum() + 1e-12)  # guarded, as it is usually written
    case.naive_fails(worst(naive, exact / mpmath.mpf(float(SMALLEST_DISTANCE2_M2)), scale))


@pytest.mark.parametrize("count", [0, 1, 7])
def test_glints_of_no_light_one_light_and_lights_in_one_place(case: HardCase, count: int) -> None:
    """As strong as the sum of the intensities, whatever it is shared among."""
    center, width = torch.tensor([[0.6, 0.8, 0.0]], requires_grad=True), torch.tensor([0.2], requires_grad=True)
    lights = torch.tensor([[2.0, 2.0, 0.1]]).repeat(count, 1)
    shares = torch.arange(1.0, count + 1)[:, None]
    out = gather_specular(torch.zeros(1, 3), center, width, PointLights(lights, shares))
    by_width = torch.autograd.grad(out.sum(), width)[0]
    q, p = ([mpmath.mpf(x) for x in v] for v in (center[0].tolist(), torch.tensor([2.0, 2.0, 0.1]).tolist()))
    scale = mpmath.mpf(count * (count + 1) // 2) / sum(x * x for x in p)
    exact = scale * lobe(p, q, mpmath.mpf(width.item()))
    slope = scale * mpmath.diff(lambda s: lobe(p, q, s), mpmath.mpf(width.item()))
    # The exponent multiplies the rounding of the angle by (angle / sigma)^2 < 2.
    case.check(worst(out.sum(), exact), 2 * FLOAT32, worst(by_width, slope), 2 * FLOAT32)
