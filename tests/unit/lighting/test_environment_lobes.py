"""Prefiltered panoramas against the sum over all pixels, which is what they stand for."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.integrate import quad

from pipeline.lighting.environment import Environment
from pipeline.lighting.environment_lobes import LOOKUP_BOUND, prefilter, sample_environment
from pipeline.lighting.lobes import LOBE_CONSTANT, angular_gaussian

SMALLEST, LARGEST = 0.06, 0.4


def single_pixel(row: int, column: int, height: int = 64) -> Environment:
    radiance = np.zeros((height, 2 * height, 3), np.float32)
    radiance[row, column] = (1, 2, 0.5)
    return Environment(radiance)


def directions_near(center: np.ndarray, spread: float, count: int) -> torch.Tensor:
    random = np.random.default_rng(0)
    near = center + spread * random.normal(size=(count, 3)) * random.random((count, 1))
    return torch.tensor(near / np.linalg.norm(near, axis=1, keepdims=True), dtype=torch.float32)


def widths(count: int, smallest: float = SMALLEST, largest: float = LARGEST) -> torch.Tensor:
    return torch.tensor(smallest * (largest / smallest) ** np.random.default_rng(1).random(count), dtype=torch.float32)


def sum_over_pixels(sky: Environment, centers: torch.Tensor, sigma: torch.Tensor) -> torch.Tensor:
    lit = sky.irradiances().any(1)
    directions, lights = sky.directions().reshape(-1, 3)[lit], torch.from_numpy(sky.irradiances()[lit])
    return angular_gaussian(torch.from_numpy(directions), centers.double()[:, None], sigma.double()[:, None]) @ lights


@pytest.mark.parametrize(("row", "column"), [(32, 5), (0, 3), (63, 100), (10, 64), (40, 127)])
def test_lone_bright_pixel_is_within_the_stated_bound(row, column) -> None:
    sky = single_pixel(row, column)
    centers, sigma = directions_near(sky.directions()[row, column], 0.3, 1500), widths(1500)
    found = prefilter(sky, SMALLEST, LARGEST).look_up(centers, sigma)
    peak = LOBE_CONSTANT / sigma[:, None] * torch.tensor(sky.irradiances().max(0))
    assert float(((found - sum_over_pixels(sky, centers, sigma)).abs() / peak).max()) < LOOKUP_BOUND


def test_uneven_sky_is_the_sum_over_its_pixels() -> None:
    """Light of very uneven strength from everywhere: errors average, and stay below the bound of a lone pixel."""
    radiance = np.random.default_rng(2).exponential(1, (48, 96, 3)) ** 4
    sky = Environment(radiance.astype(np.float32))
    sigma = widths(400, math.pi / 48)
    centers = directions_near(np.zeros(3), 1.0, 400)
    found, expected = (
        prefilter(sky, math.pi / 48, LARGEST).look_up(centers, sigma),
        sum_over_pixels(sky, centers, sigma),
    )
    assert float((found - expected).abs().max() / expected.max()) < LOOKUP_BOUND
    assert float((found - expected).square().mean().sqrt() / expected.square().mean().sqrt()) < LOOKUP_BOUND / 2


@pytest.mark.parametrize("sigma", [0.1, 0.25, 0.6])
def test_uniform_sky_is_the_integral_of_the_lobe(sigma) -> None:
    volume = quad(lambda a: 2 * math.pi * math.sin(a) * math.exp(-0.5 * (a / sigma) ** 2), 0, math.pi)[0]
    sky = Environment(np.full((64, 128, 3), 3, np.float32))
    found = prefilter(sky, 0.1, 0.6).look_up(directions_near(np.zeros(3), 1.0, 50), torch.full((50,), sigma))
    np.testing.assert_allclose(found.numpy(), 3 * LOBE_CONSTANT / sigma * volume, rtol=LOOKUP_BOUND)


def test_look_up_is_linear_in_the_light() -> None:
    one, other = single_pixel(5, 5, 32), single_pixel(20, 40, 32)
    centers, sigma = directions_near(np.zeros(3), 1.0, 200), widths(200, 0.1)
    found = [prefilter(sky, 0.1, LARGEST).look_up(centers, sigma) for sky in (one, other)]
    both = prefilter(Environment(one.radiance + 3 * other.radiance), 0.1, LARGEST).look_up(centers, sigma)
    torch.testing.assert_close(both, found[0] + 3 * found[1], rtol=1e-5, atol=1e-7)


def test_lobes_beyond_the_ladder_take_its_ends() -> None:
    """The lobe's constant goes with 1 / sigma, its solid angle with sigma^2: radiance times sigma is left,
    but for the sphere's curvature under a lobe as wide as a pixel: sigma^2 / 3."""
    sky = Environment(np.full((16, 32, 3), 2, np.float32))
    ladder = prefilter(sky, 0.01, 0.02)  # narrower than the map's pixel: one rung
    assert len(ladder.panoramas) == 1
    at = directions_near(np.zeros(3), 1.0, 10)
    sharp, wide = (ladder.look_up(at, torch.full((10,), sigma)) for sigma in (0.01, 0.02))
    torch.testing.assert_close(wide, 2 * sharp)
    np.testing.assert_allclose(sharp.numpy(), 2 * LOBE_CONSTANT * 2 * math.pi * 0.01, rtol=0.02)


def test_background_shows_each_pixel_along_its_direction() -> None:
    sky = Environment(np.random.default_rng(3).random((8, 16, 3)).astype(np.float32))
    shown = sample_environment(sky, sky.directions().reshape(-1, 3).astype(np.float32))
    np.testing.assert_allclose(shown.reshape(8, 16, 3), sky.radiance, atol=1e-4)
