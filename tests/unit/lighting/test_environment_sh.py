"""Spherical harmonics of an environment against SciPy's and against the sum over its pixels as lights."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from scipy.special import sph_harm_y

from pipeline.lighting.environment import Environment
from pipeline.lighting.environment_sh import (
    gather_environment,
    project_environment,
    spherical_harmonics,
    turned_light,
)
from pipeline.lighting.zonal import clamped_cosine_coefficients, gather_light_reference

FAR_M = 1e6
"""A point light so far away is a distant one: its direction seen from the origin is exact, its falloff undone."""

FLOAT32_CONSTANT = 6e-8
"""The oracle's (2 l + 1) / (4 pi) are float32 numbers: off by up to half of their last digit."""


def random_environment(height: int = 8) -> Environment:
    random = np.random.default_rng(0)
    return Environment(random.exponential(1, (height, 2 * height, 3)).astype(np.float32) ** 3)


def scipys(degree: int, m: int, x: float, y: float, z: float) -> float:
    value = sph_harm_y(degree, abs(m), math.acos(z), math.atan2(y, x))
    return value.real if m == 0 else (-1) ** m * math.sqrt(2) * (value.imag if m < 0 else value.real)


def test_harmonics_are_scipys() -> None:
    random = np.random.default_rng(1)
    directions = random.normal(size=(20, 3))
    directions[0], directions[1], directions[2] = (0, 0, 1), (0, 0, -1), (1, 0, 0)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    expected = [[scipys(n, m, *d) for n in range(9) for m in range(-n, n + 1)] for d in directions]
    found = spherical_harmonics(torch.from_numpy(directions))
    np.testing.assert_allclose(found.numpy(), np.array(expected), atol=1e-13)


def test_turned_light_is_that_of_turned_lamps() -> None:
    """Lamps of two colours in directions w have harmonics Y(w); turned ones those of R w, and none of R^T w."""
    turn = torch.from_numpy(Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix())
    directions = torch.nn.functional.normalize(torch.randn(3, 3, generator=torch.Generator().manual_seed(0)).double())
    colors = torch.tensor([[1.0, 0.2], [0.5, 3.0], [2.0, 0.0]]).double()
    found = turned_light(spherical_harmonics(directions).T @ colors, turn)
    np.testing.assert_allclose(found, spherical_harmonics(directions @ turn.T).T @ colors, atol=1e-12)


def test_gradient_is_finite_at_the_poles() -> None:
    poles = torch.tensor([[0.0, 0, 1], [0, 0, -1]], requires_grad=True)
    spherical_harmonics(poles).sum().backward()
    assert torch.isfinite(poles.grad).all()


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, FLOAT32_CONSTANT), (torch.float32, 1e-5)])
def test_gathered_light_is_the_sum_over_all_pixels(dtype, tolerance) -> None:
    sky = random_environment()
    directions, irradiances = sky.directions().reshape(-1, 3), sky.irradiances()
    axes = torch.from_numpy(Rotation.random(30, rng=2).as_matrix())
    expected = gather_light_reference(
        torch.zeros(30, 3, dtype=torch.float64), axes, torch.from_numpy(FAR_M * directions),
        torch.from_numpy(FAR_M**2 * irradiances),
    )  # fmt: skip
    light = torch.from_numpy(project_environment(sky))
    found = gather_environment(axes.to(dtype), light.to(dtype))
    assert float((found - expected).abs().max() / expected.abs().max()) < tolerance


def test_matte_surface_under_a_uniform_sky_reflects_its_radiance() -> None:
    """Lambert's lobe of any orientation under radiance L: L, up to what the panorama's pixels are off (1e-3)."""
    sky = Environment(np.full((32, 64, 3), 2.5, np.float32))
    light = torch.from_numpy(project_environment(sky))
    gathered = gather_environment(torch.from_numpy(Rotation.random(10, rng=3).as_matrix()), light)
    reflected = torch.einsum("palc,l->pac", gathered, torch.as_tensor(clamped_cosine_coefficients()))
    np.testing.assert_allclose(reflected.numpy(), 2.5, rtol=1e-3)
