"""Spherical harmonics to degree 8 at the poles, and Legendre sums where light runs along an axis, against mpmath."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
import torch

from pipeline.lighting.distant import arriving_light, gather_harmonics
from pipeline.lighting.environment_sh import spherical_harmonics
from pipeline.lighting.point_lights import PointLights
from pipeline.lighting.zonal import DEGREES, SMALLEST_DISTANCE2_M2, gather_light
from tests.support.naive.shading import naive_falloff
from tests.support.results.hard_case import HardCase, worst

FLOAT32 = 1e-5
"""Cosines in float32, over the root of a sum of squares, are good to 2e-7; P_8 has the slope 36 at the end of its
interval, and eight steps of the recurrence add a few roundings."""

POLES = {"north": (0.0, 0.0, 1.0), "south": (0.0, 0.0, -1.0)}


def associated_legendre(degree: int, m: int, x: mpmath.mpf) -> mpmath.mpf:
    """Rodrigues' formula, (1 - x^2)^(m/2) / (2^l l!) d^(l+m)/dx^(l+m) (x^2 - 1)^l, without the sign (-1)^m.

    A sum of at most nine terms, whose coefficients are below 2.1e6: of 40 digits, 33 are left. mpmath.legenp sums
    hypergeometric series, which take up to five seconds beside x = -1.
    """
    derivative = mpmath.mpf(0)
    for k in range((degree + m + 1) // 2, degree + 1):
        coefficient = (-1) ** (degree - k) * math.comb(degree, k) * math.perm(2 * k, degree + m)
        derivative += coefficient * x ** (2 * k - degree - m)
    return mpmath.sqrt(1 - x * x) ** m * derivative / (2**degree * math.factorial(degree))


def harmonic(degree: int, m: int, polar: mpmath.mpf, azimuth: mpmath.mpf) -> mpmath.mpf:
    """Real and orthonormal, without the Condon-Shortley sign."""
    k = abs(m)
    norm = mpmath.sqrt((2 * degree + 1) / (4 * mpmath.pi) * mpmath.factorial(degree - k) / mpmath.factorial(degree + k))
    around = mpmath.cos(k * azimuth) if m >= 0 else mpmath.sin(k * azimuth)
    return norm * associated_legendre(degree, k, mpmath.cos(polar)) * around * (mpmath.sqrt(2) if m else 1)


def pole_slopes(degree: int, m: int, azimuth: float, south: bool) -> mpmath.mpf:
    """Derivative along the meridian of an azimuth, at a pole: only m = 1 and -1 have one there, for
    P_l^1(cos t) = t l (l + 1) / 2 + ..., with the sign (-1)^(l + 1) at the other pole."""
    if abs(m) != 1:
        return mpmath.mpf(0)
    norm = mpmath.sqrt(mpmath.mpf(2 * degree + 1) / (2 * mpmath.pi * degree * (degree + 1)))
    around = mpmath.cos(azimuth) if m > 0 else mpmath.sin(azimuth)
    return norm * mpmath.mpf(degree * (degree + 1)) / 2 * around * ((-1) ** (degree + 1) if south else 1)


@pytest.mark.parametrize("pole", POLES)
def test_harmonics_at_a_pole(case: HardCase, pole: str) -> None:
    south = pole == "south"
    expected = np.zeros(81)
    for degree in range(9):
        expected[degree * (degree + 1)] = math.sqrt((2 * degree + 1) / (4 * math.pi)) * ((-1) ** degree if south else 1)
    at = torch.tensor([POLES[pole]], requires_grad=True)
    found = spherical_harmonics(at)
    slopes, exact = [], []
    for index in range(81):
        (slope,) = torch.autograd.grad(found[0, index], at, retain_graph=True)
        degree = math.isqrt(index)
        m = index - degree * (degree + 1)
        slopes.append(slope[0, :2].tolist())
        exact.append([pole_slopes(degree, m, azimuth, south) for azimuth in (0.0, math.pi / 2)])
    case.check(worst(found, [expected]), FLOAT32, worst(slopes, exact), FLOAT32)
    # By angles, Y_11 = sqrt(3 / (4 pi)) sin(polar) cos(azimuth): the azimuth has no slope at a pole.
    x, y, z = naive = [torch.tensor(component, requires_grad=True) for component in POLES[pole]]
    (torch.acos(z).sin() * torch.atan2(y, x).cos()).backward()
    case.naive_fails(worst([float(component.grad) for component in naive], [1, 0, 0]), "gradient")


def test_exact_legendre_functions_are_mpmaths(case: HardCase) -> None:
    degrees = [(degree, m) for degree in range(9) for m in range(degree + 1)]
    with mpmath.workdps(40):
        x = mpmath.cos(mpmath.mpf("0.7"))
        found = [associated_legendre(degree, m, x) for degree, m in degrees]
        expected = [(-1) ** m * mpmath.re(mpmath.legenp(degree, m, x, type=2)) for degree, m in degrees]
        errors = [a / b - 1 for a, b in zip(found, expected, strict=True)]
    case.check(worst(errors, [0] * len(degrees)), 1e-33)


@pytest.mark.parametrize("polar", [1e-6, 1e-3, math.pi - 1e-3])
def test_harmonics_beside_a_pole(case: HardCase, polar: float) -> None:
    azimuth = 0.7
    along = (math.cos(polar) * math.cos(azimuth), math.cos(polar) * math.sin(azimuth), -math.sin(polar))
    place = (math.sin(polar) * math.cos(azimuth), math.sin(polar) * math.sin(azimuth), math.cos(polar))
    at = torch.tensor([place], dtype=torch.float64, requires_grad=True)
    found = spherical_harmonics(at)
    exact, slopes, exact_slopes = [], [], []
    for index in range(81):
        degree = math.isqrt(index)
        m = index - degree * (degree + 1)
        (slope,) = torch.autograd.grad(found[0, index], at, retain_graph=True)
        slopes.append(float(slope[0] @ torch.tensor(along, dtype=torch.float64)))
        with mpmath.workdps(40):
            t, around = mpmath.mpf(polar), mpmath.mpf(azimuth)
            exact.append(harmonic(degree, m, t, around))
            h = t / 1000  # differences of fourth order, h^4 = 1e-12 of the scale on which it changes
            h = min(h, mpmath.mpf("1e-6"))
            y = [harmonic(degree, m, t + k * h, around) for k in (-2, -1, 1, 2)]
            exact_slopes.append((y[0] - 8 * y[1] + 8 * y[2] - y[3]) / (12 * h))
    case.check(worst(found, [exact]), 1e-12, worst(slopes, exact_slopes), 1e-9)
    if polar < 1e-3:  # by the angle whose cosine z is
        angle = mpmath.mpf(math.acos(place[2]))
        naive = [harmonic(math.isqrt(k), k - math.isqrt(k) * (math.isqrt(k) + 1), angle, azimuth) for k in range(81)]
        case.naive_fails(worst(naive, exact))


@pytest.mark.parametrize("along", [1, -1])
def test_light_exactly_along_an_axis(case: HardCase, along: int) -> None:
    """P_l(1) = 1 and P_l'(1) = l (l + 1) / 2; at -1 with alternating signs."""
    axes = torch.eye(3)[None].clone().requires_grad_()
    light, power = torch.tensor([[0.0, 0.0, 2.0 * along]]), torch.tensor([[8.0]])
    found = gather_light(torch.zeros(1, 3), axes, PointLights(light, power))
    values, slopes = found[0, 2, :, 0], []
    for degree in range(DEGREES):
        (slope,) = torch.autograd.grad(values[degree], axes, retain_graph=True)
        slopes.append(float(slope[0, 2, 2]) * along)
    degrees = np.arange(DEGREES)
    weight = 2.0 * (2 * degrees + 1) / (4 * np.pi)
    exact = weight * float(along) ** degrees
    exact_slopes = weight * degrees * (degrees + 1) / 2 * float(along) ** (degrees + 1)
    case.check(worst(values, exact), FLOAT32, worst(slopes, exact_slopes), FLOAT32)
    # Polynomials by angles, as cos(8 acos x), whose slope is 64, have none at the end of the interval.
    x = torch.tensor(float(along), requires_grad=True)
    torch.cos(8 * torch.acos(x)).backward()
    case.naive_fails(worst(x.grad, 64 * along), "gradient")


def test_light_across_all_degrees_beside_an_axis(case: HardCase) -> None:
    """Where P_8 is steepest."""
    axes = torch.eye(3)[None]
    light = torch.tensor([[0.3, -0.2, 2.0]])
    found = gather_light(torch.zeros(1, 3), axes, PointLights(light, torch.ones(1, 1)))[0, 2, :, 0]
    exact_light = [mpmath.mpf(x) for x in light[0].tolist()]
    distance2 = sum(x * x for x in exact_light)
    cosine = exact_light[2] / mpmath.sqrt(distance2)
    exact = [mpmath.legendre(n, cosine) * (2 * n + 1) / (4 * mpmath.pi) / distance2 for n in range(DEGREES)]
    case.check(worst(found, exact), FLOAT32)


@pytest.mark.parametrize("count", [0, 1, 6])
def test_no_light_one_light_and_lights_in_one_place(case: HardCase, count: int) -> None:
    points = torch.tensor([[0.1, 0.0, -0.2]], requires_grad=True)
    place, shares = torch.tensor([[1.0, 2.0, 2.0]]).repeat(count, 1), torch.arange(1.0, count + 1)[:, None]
    found = gather_light(points, torch.eye(3)[None], PointLights(place, shares))[0, 2, 3, 0]
    (slope,) = torch.autograd.grad(found, points)

    def exact(x: mpmath.mpf, y: mpmath.mpf, z: mpmath.mpf) -> mpmath.mpf:
        offset = [1 - x, 2 - y, 2 - z]
        distance2 = sum(a * a for a in offset)
        total = mpmath.mpf(count * (count + 1)) / 2
        return total * mpmath.legendre(3, offset[2] / mpmath.sqrt(distance2)) * 7 / (4 * mpmath.pi) / distance2

    at = tuple(mpmath.mpf(x) for x in points[0].tolist())
    slopes = [mpmath.diff(exact, at, tuple(int(i == k) for k in range(3))) for i in range(3)]
    case.check(worst(found, exact(*at)), FLOAT32, worst(slope[0], slopes), FLOAT32)


def test_all_lights_on_one_side(case: HardCase) -> None:
    """A ring of lights far to one side is one light there; the other side's odd degrees are negative, not empty."""
    around = 2 * np.pi * np.arange(64) / 64
    ring = torch.tensor(np.stack([np.full(64, 1e4), np.cos(around), np.sin(around)], 1), dtype=torch.float32)
    found = gather_light(torch.zeros(1, 3), torch.eye(3)[None], PointLights(ring, torch.full((64, 1), 1e8 / 64)))[
        0, 0, :, 0
    ]
    case.check(worst(found, (2 * np.arange(DEGREES) + 1) / (4 * np.pi)), FLOAT32)


@pytest.mark.parametrize("gather", ["zonal", "harmonics", "arriving"])
def test_a_light_on_the_texel_itself(case: HardCase, gather: str) -> None:
    """Lights nearer than a tenth of a millimetre count as that near: strong, and finite."""
    place, light, power = torch.zeros(1, 3), torch.zeros(1, 3), torch.ones(1, 1)
    found = {
        "zonal": lambda: 4 * math.pi * gather_light(place, torch.eye(3)[None], PointLights(light, power))[0, 2, 0, 0],
        "harmonics": lambda: (
            math.sqrt(4 * math.pi) * gather_harmonics(place, torch.eye(3), PointLights(light, power))[0, 0, 0]
        ),
        "arriving": lambda: arriving_light(place, PointLights(light, power))[0, 0],
    }[gather]()
    case.check(worst(found, 1 / float(SMALLEST_DISTANCE2_M2)), FLOAT32)
    case.naive_fails(worst(naive_falloff((light - place).norm()), 1 / float(SMALLEST_DISTANCE2_M2)))
