"""The angular spherical Gaussian: values from mpmath, slopes at its singular directions, the mirror law."""

import mpmath
import pytest
import torch

from pipeline.lighting.lobes import angle_between, angular_gaussian, mirror_direction, unit


def rotated(angle: float) -> torch.Tensor:
    """A unit vector at an angle from x, in double precision."""
    return torch.tensor([float(mpmath.cos(angle)), float(mpmath.sin(angle)), 0.0], dtype=torch.float64)


@pytest.mark.parametrize("sigma", [0.01, 0.1, 0.25])
@pytest.mark.parametrize("angle", [0.0, 1e-6, 1e-3, 0.02, 0.5, 3.0])
def test_value_against_mpmath(sigma, angle):
    constant = 1 / (mpmath.sqrt(2) * mpmath.pi ** (mpmath.mpf(2) / 3) * sigma)
    expected = float(constant * mpmath.exp(-((mpmath.mpf(angle) / sigma) ** 2) / 2))
    value = angular_gaussian(rotated(0), rotated(angle), torch.tensor(sigma, dtype=torch.float64)).item()
    assert value == pytest.approx(expected, rel=1e-6, abs=1e-30)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("sigma", [0.01, 0.25])
def test_slope_is_finite_and_vanishes_at_the_peak(dtype, sigma):
    for q in (torch.tensor([1.0, 0, 0]), torch.tensor([-1.0, 0, 0])):
        p = torch.tensor([1.0, 0, 0], dtype=dtype, requires_grad=True)
        width = torch.tensor(sigma, dtype=dtype, requires_grad=True)
        angular_gaussian(p, q.to(dtype), width).backward()
        assert torch.isfinite(p.grad).all() and torch.isfinite(width.grad)
        assert p.grad[1:].abs().max() < 1e-3


@pytest.mark.parametrize("angle", [1e-5, 1e-3, 0.3])
def test_slope_against_mpmath(angle):
    sigma = 0.05
    turn = torch.tensor(angle, dtype=torch.float64, requires_grad=True)
    q = torch.stack([turn.cos(), turn.sin(), torch.zeros_like(turn)])
    angular_gaussian(rotated(0), q, torch.tensor(sigma, dtype=torch.float64)).backward()
    constant = 1 / (mpmath.sqrt(2) * mpmath.pi ** (mpmath.mpf(2) / 3) * sigma)
    expected = float(-constant * angle / sigma**2 * mpmath.exp(-((angle / sigma) ** 2) / 2))
    assert turn.grad.item() == pytest.approx(expected, rel=1e-4)


def test_small_angles_keep_their_digits_in_float32():
    angle = angle_between(torch.tensor([1.0, 0, 0]), unit(torch.tensor([1.0, 1e-4, 0])))
    assert angle.item() == pytest.approx(1e-4, rel=1e-4)


def test_mirror_direction_obeys_the_mirror_law():
    generator = torch.Generator().manual_seed(0)
    normal, out = (unit(torch.randn(100, 3, generator=generator, dtype=torch.float64)) for _ in range(2))
    q = mirror_direction(normal, out)
    assert torch.allclose(q.norm(dim=-1), torch.ones(100, dtype=torch.float64))
    assert torch.allclose((q * normal).sum(-1), (out * normal).sum(-1))
    assert torch.allclose(torch.linalg.cross(q + out, normal), torch.zeros(100, 3, dtype=torch.float64), atol=1e-12)


def test_unit_of_zero_is_zero_with_finite_slope():
    vector = torch.zeros(3, requires_grad=True)
    unit(vector).sum().backward()
    assert (unit(vector) == 0).all() and torch.isfinite(vector.grad).all()
