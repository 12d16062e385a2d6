"""GGX, or a Gaussian, where formulas lose their digits: grazing light, narrow widths, lights on the point, none."""

from __future__ import annotations

import math
from collections.abc import Callable

import mpmath
import numpy as np
import pytest
import torch

from pipeline.avatar.appearance.penalties import GGX_WIDTH_BOUNDS
from pipeline.lighting.lobes import LOBE_CONSTANT, unit
from pipeline.lighting.matte import arriving_vectors
from pipeline.lighting.microfacet import DIELECTRIC_F0, gather_reflections
from pipeline.lighting.point_lights import PointLights
from tests.support.naive.shading import naive_distribution
from tests.support.results.hard_case import HardCase, worst

DIRECTION_RAD = 1e-7
"""Directions of float32, and the one halfway between two of them if they are not nearly opposite, are good to this."""

ROUNDING = 2e-6
"""Thirty operations of float32, relative."""

UP = torch.tensor([[0.0, 0.0, 1.0]])


def direction(degrees: float, around: float = 0.0) -> torch.Tensor:
    """A unit vector at an angle from the normal."""
    polar, turn = math.radians(degrees), math.radians(around)
    return unit(torch.tensor([[math.sin(polar) * math.cos(turn), math.sin(polar) * math.sin(turn), math.cos(polar)]]))


BOTH = pytest.mark.parametrize("gaussian", [False, True], ids=["GGX", "Gaussian"])


def reflected(normal: list, to_camera: list, alpha: mpmath.mpf, to_light: list, gaussian: bool = False) -> mpmath.mpf:
    """D G F / (4 (n . w_o)) of Heitz 2014 and Schlick, of vectors of any length; D by the tangent (eq. 71), or
    4 / F0 of RFGCA 13 for twice the angle between normal and half vector."""
    n, o, i = (unit_exact(v) for v in (normal, to_camera, to_light))
    h = unit_exact([a + b for a, b in zip(o, i, strict=True)])
    ci, co, ch, cd = dot(n, i), dot(n, o), dot(n, h), dot(o, h)
    tangent2 = (1 - ch**2) / ch**2
    d = 1 / (mpmath.pi * alpha**2 * ch**4 * (1 + tangent2 / alpha**2) ** 2)
    if gaussian:
        sigma, angle = mpmath.sqrt(2) * alpha, mpmath.acos(ch)
        d = 4 / mpmath.mpf(DIELECTRIC_F0) * LOBE_CONSTANT / sigma * mpmath.exp(-((2 * angle / sigma) ** 2) / 2)
    lambdas = [(mpmath.sqrt(1 + alpha**2 * (1 - c**2) / c**2) - 1) / 2 for c in (ci, co)]
    f = DIELECTRIC_F0 + (1 - mpmath.mpf(DIELECTRIC_F0)) * (1 - cd) ** 5
    return d * f / (1 + sum(lambdas)) / (4 * co)


def unit_exact(vector: list) -> list:
    length = mpmath.sqrt(dot(vector, vector))
    return [x / length for x in vector]


def dot(a: list, b: list) -> mpmath.mpf:
    return sum(x * y for x, y in zip(a, b, strict=True))


def by_normal(function: Callable[[list], mpmath.mpf]) -> list:
    """Derivatives by the two components across the normal (0, 0, 1)."""
    with mpmath.workdps(60):
        step = mpmath.mpf(10) ** -20
        ends = [[function([s * step * (k == 0), s * step * (k == 1), mpmath.mpf(1)]) for s in (1, -1)] for k in (0, 1)]
        return [(ahead - behind) / (2 * step) for ahead, behind in ends]


def naive_reflection(to_camera: torch.Tensor, to_light: torch.Tensor, alpha: float, gaussian: bool) -> torch.Tensor:
    """As renderers write it: 1e-4 beside the cosines that are divided by, and the Gaussian's angle as acos."""
    towards = to_light / to_light.norm(dim=-1, keepdim=True)
    half = torch.nn.functional.normalize(towards + to_camera, dim=-1)
    ci, co, ch, cd = towards[..., 2], to_camera[..., 2], half[..., 2], (to_camera * half).sum(-1)
    distribution = naive_distribution(to_camera, towards, alpha)
    if gaussian:
        sigma = math.sqrt(2) * alpha
        distribution = 4 / DIELECTRIC_F0 * LOBE_CONSTANT / sigma * torch.exp(-((2 * torch.acos(ch) / sigma) ** 2) / 2)
    lambdas = [((1 + alpha**2 * (1 - c**2) / c**2).sqrt() - 1) / 2 for c in (ci, co)]
    fresnel = DIELECTRIC_F0 + (1 - DIELECTRIC_F0) * (1 - cd) ** 5
    return distribution * fresnel / (1 + sum(lambdas)) / (4 * ci * co + 1e-4) * ci / to_light.square().sum(-1)


def exact_distribution(to_camera: torch.Tensor, to_light: torch.Tensor, alpha: float) -> mpmath.mpf:
    o, i = (unit_exact([mpmath.mpf(x) for x in v[0].tolist()]) for v in (to_camera, to_light))
    cosine = unit_exact([a + b for a, b in zip(o, i, strict=True)])[2]
    a2 = mpmath.mpf(torch.tensor(alpha).item()) ** 2
    return a2 / (mpmath.pi * (cosine**2 * (a2 - 1) + 1) ** 2)


def check_reflection(
    case: HardCase, to_camera: torch.Tensor, to_light: torch.Tensor, alpha: float, gaussian: bool = False,
    naive: bool = True,
) -> None:  # fmt: skip
    normal, width = UP.clone().requires_grad_(), torch.tensor([alpha], requires_grad=True)
    seen = np.full((1, 1), 255, np.uint8)
    out = gather_reflections(
        torch.zeros(1, 3), normal, to_camera, width, PointLights(to_light, torch.ones(1, 1), seen), gaussian
    )
    slopes = torch.autograd.grad(out.sum(), (normal, width))
    o, i = ([mpmath.mpf(x) for x in v[0].tolist()] for v in (to_camera, to_light))
    n, a, falloff = [mpmath.mpf(x) for x in (0, 0, 1)], mpmath.mpf(width.item()), 1 / dot(i, i)
    across = [s * falloff for s in by_normal(lambda m: reflected(m, o, a, i, gaussian))]
    along_width = falloff * mpmath.diff(lambda w: reflected(n, o, w, i, gaussian), a)
    value = falloff * reflected(n, o, a, i, gaussian)
    # A slope that vanishes by symmetry is measured against the steepest nearby.
    scale = max(float(abs(s)) for s in across) + float(value) / alpha
    errors = worst(slopes[0][0, :2], across, scale), worst(slopes[1], along_width)
    # log D changes by at most 2 / alpha per radian, and its slope by 4 / alpha^2; directions that nearly cancel leave
    # that much less of the one halfway, which the slope sees in full and the value, at its maximum there, does not.
    halfway = DIRECTION_RAD / float(mpmath.sqrt(sum((a + b) ** 2 for a, b in zip(o, i, strict=True)))) * 2
    bounds = 2 / alpha * DIRECTION_RAD + ROUNDING, 4 / alpha * halfway + ROUNDING
    case.check(worst(out, value), bounds[0], max(errors), bounds[1])
    if naive:
        case.naive_fails(worst(naive_reflection(to_camera, to_light, alpha, gaussian), value))


@BOTH
@pytest.mark.parametrize("alpha", [0.01, *GGX_WIDTH_BOUNDS])
def test_the_middle_of_a_highlight(case: HardCase, alpha: float, gaussian: bool) -> None:
    # At 0.05 the naive version is right to the bound, and so is a Gaussian whose half vector happens to round well.
    naive = alpha == 1 or (alpha, gaussian) == (0.01, False)
    check_reflection(case, direction(30), direction(30, 180), alpha, gaussian, naive)


@BOTH
@pytest.mark.parametrize("alpha", [1e-3, 1e-2])
def test_the_flank_of_a_narrow_highlight(case: HardCase, alpha: float, gaussian: bool) -> None:
    """Half a width beside the middle, where the usual formula subtracts one from nearly one."""
    camera, light = direction(20), direction(20 + math.degrees(alpha), 180)
    check_reflection(case, camera, light, alpha, gaussian, naive=gaussian)
    if gaussian:
        return
    exact = exact_distribution(camera, light, alpha)
    case.naive_fails(worst(naive_distribution(camera, light, alpha), exact))


@BOTH
@pytest.mark.parametrize("alpha", [0.01, *GGX_WIDTH_BOUNDS])
@pytest.mark.parametrize("height", [1e-1, 1e-3])
def test_camera_and_light_graze_the_surface(case: HardCase, alpha: float, height: float, gaussian: bool) -> None:
    """On either side, a thousandth of their distance above it: the mirror direction, and far beside it."""
    low = 90 - math.degrees(height)
    check_reflection(case, direction(low), direction(low, 180), alpha, gaussian)


@pytest.mark.parametrize("alpha", GGX_WIDTH_BOUNDS)
def test_light_beside_a_grazing_camera(case: HardCase, alpha: float) -> None:
    check_reflection(case, direction(89.9), direction(89.8, 3), alpha)


@BOTH
@pytest.mark.parametrize("case_name", ["at the horizon", "below it", "on the point"])
def test_lights_that_no_highlight_comes_from(case: HardCase, case_name: str, gaussian: bool) -> None:
    """Nothing, and without slope; the usual 1 / (4 cos cos), or a direction over its length, are not finite there."""
    light = {"at the horizon": [[3.0, 0, 0]], "below it": [[1.0, 0, -1.0]], "on the point": [[0.0, 0, 0]]}[case_name]
    normal, width = UP.clone().requires_grad_(), torch.tensor([0.05], requires_grad=True)
    place, light, seen = torch.zeros(1, 3), torch.tensor(light), np.full((1, 1), 255, np.uint8)
    out = gather_reflections(place, normal, direction(30), width, PointLights(light, torch.ones(1, 1), seen), gaussian)
    slopes = torch.autograd.grad(out.sum(), (normal, width))
    case.check(worst(out, [[0]]), 0, max(float(s.abs().max()) for s in slopes), 0)
    if case_name == "on the point":
        case.naive_fails(worst(naive_reflection(direction(30), light, 0.05, gaussian), [0]))
    if case_name == "at the horizon":
        camera, towards = direction(30)[0], light[0] / light[0].norm()
        cosine, alike = (towards * normal[0]).sum().clamp(min=0), (camera * normal[0]).sum()
        distribution = naive_distribution(camera, towards, 0.05)
        naive = distribution * cosine / (4 * cosine * alike).clamp(min=1e-4)  # guarded, as it is usually written
        case.naive_fails(torch.autograd.grad(naive, normal)[0].abs().max(), "gradient")


@pytest.mark.parametrize("count", [0, 1, 5])
def test_irradiance_of_no_light_one_light_and_lights_in_one_place(case: HardCase, count: int) -> None:
    normal = unit(torch.tensor([[0.3, -0.2, 0.9]]))
    light, seen = torch.tensor([[1.0, 0.5, 2.0]]), np.full((count, 1), 255, np.uint8)
    found = arriving_vectors(torch.zeros(1, 3), normal, PointLights(light.repeat(count, 1), torch.ones(count, 1), seen))
    vector = [mpmath.mpf(x) for x in (1, 0.5, 2)]
    exact = [count * x / dot(vector, vector) ** mpmath.mpf(1.5) for x in vector]
    cosine = dot(exact, [mpmath.mpf(x) for x in normal[0].tolist()])
    irradiance = (found[0, 0] * normal[0]).sum()
    # The vector is the derivative of the irradiance by the normal.
    case.check(worst(irradiance, cosine), 1e-6, worst(found[0, 0], exact), 1e-6)
