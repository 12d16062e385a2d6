"""The sRGB curve against published pairs, the scalar definition of IEC 61966-2-1, and its gradient at zero."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from pipeline.base.color import linear_from_srgb, srgb_from_linear


def reference(linear: float) -> float:
    return 12.92 * linear if linear <= 0.0031308 else 1.055 * linear ** (1 / 2.4) - 0.055


def test_matches_the_standard_one_number_at_a_time() -> None:
    linear = np.concatenate([np.linspace(-0.1, 0.01, 200), np.linspace(0.01, 4, 200)])
    expected = [reference(value) for value in linear]
    np.testing.assert_allclose(srgb_from_linear(linear), expected, rtol=1e-14, atol=0)
    torch.testing.assert_close(
        srgb_from_linear(torch.from_numpy(linear)).numpy(), np.array(expected), rtol=1e-14, atol=0
    )


def test_mid_gray_and_the_ends() -> None:
    """sRGB 188/255 is linear 0.5029 to four digits, the textbook value of 'half the light'."""
    np.testing.assert_allclose(linear_from_srgb(np.array([0.0, 188 / 255, 1.0])), [0, 0.5029, 1], atol=5e-5)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_round_trip_below_zero_and_above_one(dtype: type) -> None:
    values = np.linspace(-1, 8, 2001).astype(dtype)
    # The published constants leave a step of 3e-8 at the break; elsewhere a few roundings.
    tolerance = 1e-7 + 8 * np.finfo(dtype).eps * 8
    np.testing.assert_allclose(linear_from_srgb(srgb_from_linear(values)), values, atol=tolerance)
    assert srgb_from_linear(values).dtype == dtype


def test_both_curves_rise_everywhere() -> None:
    values = np.sort(np.concatenate([np.linspace(-0.01, 1.2, 5001), [0.0031308, 0.04045]]))
    assert (np.diff(srgb_from_linear(values)) > 0).all()
    assert (np.diff(linear_from_srgb(values)) > 0).all()


@pytest.mark.parametrize("curve", [srgb_from_linear, linear_from_srgb])
def test_gradient_is_finite_at_zero_below_and_right_elsewhere(curve) -> None:
    values = torch.tensor([-1.0, 0.0, 1e-12, 0.001, 0.2, 3.0], dtype=torch.float64, requires_grad=True)
    curve(values).sum().backward()
    assert torch.isfinite(values.grad).all()
    straight = 12.92 if curve is srgb_from_linear else 1 / 12.92
    torch.testing.assert_close(values.grad[:4], torch.full((4,), straight, dtype=torch.float64))
    assert torch.autograd.gradcheck(curve, values[4:].detach().requires_grad_())
