"""The sRGB curve against published pairs, the scalar definition of IEC 61966-2-1, and its gradient at zero."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from pipeline.base.color import POLYNOMIALS, corrected, linear_from_srgb, srgb_from_linear


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


COLOUR_SCIENCE = {
    3: 3.3, 4: 7.3, 5: 8.58, 7: 13.5, 8: 14.99, 10: 23.19, 11: 24.89, 14: 33.937, 16: 24.959, 17: 41.959, 19: 31.449,
    20: 51.449, 22: 33.542, 35: 92.7766,
}  # fmt: skip
"""Number of columns -> 1 term + 2 term + 3 term ... of (0.2, 0.5, 0.7), by `matrix_augmented_Cheung2004` of
colour-science 0.4.7: each order of the terms gives another sum."""


@pytest.mark.parametrize("columns", COLOUR_SCIENCE)
def test_polynomials_have_the_terms_of_another_program_in_its_order(columns) -> None:
    weights = np.tile(np.arange(1.0, columns + 1), (3, 1)) * [[1], [2], [-1]]
    expected = COLOUR_SCIENCE[columns] * np.array([1, 2, -1])
    rgb = np.array([[[0.2, 0.5, 0.7]]])
    np.testing.assert_allclose(corrected(rgb, weights), expected[None, None], rtol=1e-12)
    torch.testing.assert_close(
        corrected(torch.from_numpy(rgb), torch.from_numpy(weights)).numpy()[0, 0], expected, rtol=1e-12, atol=0
    )


def test_polynomials_are_all_there() -> None:
    assert set(POLYNOMIALS) == set(COLOUR_SCIENCE)
