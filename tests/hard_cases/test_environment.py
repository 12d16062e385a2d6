"""Panoramas at their extremes: a sun of one pixel, a pole, the seam, light of twelve decades, no light."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
import torch
import trimesh

from pipeline.geometry.mesh import area_vectors, unit_or
from pipeline.lighting.environment import Environment
from pipeline.lighting.environment_lobes import LOOKUP_BOUND, PIXELS_PER_SIGMA, prefilter
from pipeline.lighting.environment_sh import gather_environment, project_environment
from pipeline.lighting.irradiance import Samples, trace_irradiance
from pipeline.lighting.lobes import LOBE_CONSTANT
from pipeline.lighting.standard_error import TexelBlocks
from pipeline.lighting.visibility import Occluders
from pipeline.lighting.zonal import DEGREES
from tests.support.results.hard_case import HardCase, worst

HEIGHT = 32

SLOPE_BOUND = 0.004 * 2 * math.pi * PIXELS_PER_SIGMA
"""An error of 0.4 % of the peak (`PIXELS_PER_SIGMA`) that comes and goes within a pixel, over the steepest slope."""

SUNS = {"zenith": (0, 7), "nadir": (HEIGHT - 1, 40), "seam": (12, 0), "other side of the seam": (12, 2 * HEIGHT - 1)}
"""(row, column) of the only bright pixel."""


def sun(row: int, column: int, height: int = HEIGHT, background: float = 0.0) -> Environment:
    radiance = np.full((height, 2 * height, 3), background, np.float32)
    radiance[row, column] = 1e4
    return Environment(radiance)


def pixel(row: int, column: int, height: int = HEIGHT) -> tuple[list[mpmath.mpf], mpmath.mpf]:
    """Exact direction and solid angle."""
    polar, around = mpmath.pi * (row + 0.5) / height, mpmath.pi * (column + 0.5) / height
    place = [mpmath.sin(polar) * mpmath.sin(around), mpmath.cos(polar), -mpmath.sin(polar) * mpmath.cos(around)]
    band = mpmath.cos(mpmath.pi * row / height) - mpmath.cos(mpmath.pi * (row + 1) / height)
    return place, mpmath.pi / height * band


@pytest.mark.parametrize("place", SUNS)
def test_a_sun_of_one_pixel_by_harmonics(case: HardCase, place: str) -> None:
    """At every degree and along every axis what Legendre's polynomial says, at the sun itself and opposite to it."""
    direction, solid_angle = pixel(*SUNS[place])
    toward = np.array(direction, dtype=float)
    side = unit_or(np.cross(toward, [0.3, 0.5, 0.7]), 0.0)
    frames = np.stack([toward, side, -np.cross(toward, side)], 1)[None]
    found = gather_environment(torch.from_numpy(frames), torch.from_numpy(project_environment(sun(*SUNS[place]))))
    exact = [
        [(2 * n + 1) / (4 * mpmath.pi) * mpmath.legendre(n, cosine) * 10**4 * solid_angle for n in range(DEGREES)]
        for cosine in (1, 0, 0)
    ]
    case.check(worst(found[0, :, :, 0], exact), 1e-12)
    # A panorama whose pixels all count alike: a row near a pole has less of the sphere, one near the horizon more.
    naive = float(4 * mpmath.pi / (2 * HEIGHT**2))
    case.naive_fails(worst(naive, solid_angle))


def test_a_uniform_sky_has_one_harmonic(case: HardCase) -> None:
    """All but L_00 = L sqrt(4 pi) vanish, as far as the middles of pixels stand for them."""
    light = project_environment(Environment(np.full((64, 128, 3), 2.5, np.float32)))
    expected = np.zeros((81, 3))
    expected[0] = 2.5 * math.sqrt(4 * math.pi)
    # The midpoint rule over rows of h = pi / 64: h^2 / 24 times a second derivative, at most l (l + 1) Y_l.
    case.check(worst(light, expected), (math.pi / 64) ** 2 / 24 * 72 * 1.2)
    sky = Environment(np.full((64, 128, 3), 2.5, np.float32))
    alike = sky.directions().reshape(-1, 3)[:, 1]
    # Y_20 about the vertical, pixels counted alike.
    naive = math.sqrt(5 / (16 * math.pi)) * (3 * alike**2 - 1).sum() * 2.5 * 4 * math.pi / len(alike)
    case.naive_fails(naive / expected[0, 0])


@pytest.mark.parametrize("place", SUNS)
def test_a_sun_of_one_pixel_by_prefiltered_lobes(case: HardCase, place: str) -> None:
    """Around it and across the pole or the seam, over the lobe's peak."""
    sigma = 0.15
    direction, solid_angle = pixel(*SUNS[place])
    toward = np.array(direction, dtype=float)
    random = np.random.default_rng(0)
    special = [toward, -toward, [0, 1, 0], [0, -1, 0], [0, 0, -1]]
    centers = unit_or(np.concatenate([special, toward + 0.2 * random.normal(size=(200, 3))]), 0.0)
    angles = np.arctan2(np.linalg.norm(np.cross(centers, toward), axis=1), centers @ toward)
    peak = 1e4 * float(solid_angle) * LOBE_CONSTANT / sigma
    exact = peak * np.exp(-0.5 * (angles / sigma) ** 2)
    ladder = prefilter(sun(*SUNS[place]), sigma, 2 * sigma)
    q = torch.tensor(centers, dtype=torch.float32, requires_grad=True)
    found = ladder.look_up(q, torch.full((len(centers),), sigma))[:, 0]
    (slope,) = torch.autograd.grad(found.sum(), q)
    across = slope.double().numpy()
    across -= (across * centers).sum(1, keepdims=True) * centers
    away = unit_or(toward - (centers @ toward)[:, None] * centers, 0.0)
    slopes = (exact * angles / sigma**2)[:, None] * away
    # At a pole itself an azimuth has no slope: there it is but finite.
    far = np.abs(centers[:, 1]) < 0.999
    assert torch.isfinite(slope).all()
    steepest = peak / sigma * math.exp(-0.5)
    case.check(worst(found, exact, peak), LOOKUP_BOUND, worst(across[far], slopes[far], steepest), SLOPE_BOUND)
    alike = 4 * math.pi / (2 * HEIGHT**2) / float(solid_angle)  # a panorama whose pixels all count alike
    case.naive_fails(worst(alike * exact, exact, peak))


def sphere() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    mesh = trimesh.creation.icosphere(2)
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
    return vertices, faces, vertices[faces].mean(1), unit_or(area_vectors(vertices, faces), 0.0)


@pytest.mark.parametrize("place", ["zenith", "seam"])
def test_a_sun_of_one_pixel_is_found_by_single_draws(case: HardCase, place: str) -> None:
    """One ray per texel under a sun 1e8 times brighter than the sky: draws by power meet it, uniform ones do not."""
    vertices, faces, points, normals = sphere()
    lights = sun(*SUNS[place], background=1e-4).lights()
    direction, _ = pixel(*SUNS[place])
    lit = normals @ np.array(direction, dtype=float) > 1e-6
    texel = np.stack(np.divmod(np.arange(len(points)), 20), 1)
    errors = {}
    for sampling in ("power", "uniform"):
        samples = Samples(1, sampling, "random", TexelBlocks(texel), np.random.default_rng(0))
        found = trace_irradiance(Occluders(vertices, faces), points, normals, lights, samples=samples)
        errors[sampling] = float(np.sqrt(np.mean((found.values - lit) ** 2)))
    # The sky's share of all light: 1e-8 times the spheres' pixels over the sun's, and as likely drawn.
    case.check(errors["power"], 1e-3)
    case.naive_fails(errors["uniform"])


def test_a_black_sky(case: HardCase) -> None:
    """No light at all: no harmonics, no reflections, and irradiance one by definition; shares of it are 0 / 0."""
    sky = Environment(np.zeros((8, 16, 3), np.float32))
    vertices, faces, points, normals = sphere()
    found = trace_irradiance(Occluders(vertices, faces), points, normals, sky.lights())
    ladder = prefilter(sky, 0.2, 0.25)
    q = torch.eye(3, requires_grad=True)
    gloss = ladder.look_up(q, torch.full((3,), 0.2))
    (slope,) = torch.autograd.grad(gloss.sum(), q)
    assert found.unlit
    values = [worst(project_environment(sky), np.zeros((81, 3))), worst(gloss, np.zeros((3, 3))),
              worst(found.values, np.ones(len(points)))]  # fmt: skip
    case.check(max(values), 0, float(slope.abs().max()), 0)
    lights = sky.lights()
    with np.errstate(invalid="ignore"):
        naive = (normals @ lights.places.T > 0) @ lights.luminances / lights.luminances.sum()
    case.naive_fails(worst(naive, np.ones(len(points))))
