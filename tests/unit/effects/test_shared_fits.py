"""Coefficients that texels share are judged on other texels than those they were found on."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.effects.shared_fits import crossed, solve_apart, solve_shared

TEXELS, EACH = 40, 3
POINT = np.repeat(np.arange(TEXELS), EACH)


def drawn(columns):
    random = np.random.default_rng(3)
    return random.normal(size=(len(POINT), 1, 3)), random.normal(size=(len(POINT), columns, 3))


@pytest.mark.parametrize("solve", [solve_shared, solve_apart])
def test_noise_explains_no_noise(solve):
    """Thirty columns fit what they are fitted to a little; what they are not, less than none would."""
    target, columns = drawn(30)
    whole = float((target**2).mean())
    fitted = float(((target[:, 0] - (columns * solve(target, columns)).sum(1)) ** 2).mean())
    assert fitted < 0.99 * whole < whole < crossed(target, columns, POINT, solve)


@pytest.mark.parametrize("solve", [solve_shared, solve_apart])
def test_what_is_there_is_found_on_either_half(solve):
    noise, columns = drawn(3)
    planted = (columns * np.array([0.5, 0.0, 2.0])[:, None]).sum(1)
    target = planted[:, None] + 0.1 * noise
    np.testing.assert_allclose(crossed(target, columns, POINT, solve), 0.1**2 * (noise**2).mean(), rtol=0.15)


def test_colours_that_are_solved_apart_are_their_own_and_never_negative():
    _, columns = drawn(3)
    true = np.array([[0.5, 1.0, 0.0], [0.0, 0.3, 2.0], [1.0, 0.0, 0.1]])
    np.testing.assert_allclose(solve_apart((columns * true).sum(1)[:, None], columns), true, atol=1e-9)
    found = solve_apart(-columns[:, :1], columns)
    assert (found >= 0).all() and found[0].max() == 0
