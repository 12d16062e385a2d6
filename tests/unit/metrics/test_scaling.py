"""Fits to planted laws: exponents are found, intervals cover as often as they say, and nothing is made of nothing."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.metrics.scaling import MOST_EXPONENT, ScalingLaw, fit_scaling

SIZES = 100 * 2.0 ** np.arange(6)


def planted(exponent: float, fixed: float, sizes: np.ndarray = SIZES) -> np.ndarray:
    """Costs of a law that makes 1 at the first size, and `fixed` beside."""
    return fixed + (sizes / sizes[0]) ** exponent


@pytest.mark.parametrize("fixed", [0.0, 0.5, 20.0])
@pytest.mark.parametrize("exponent", [0.3, 1.0, 2.0, 3.0])
def test_exact_costs_give_the_exact_law(exponent, fixed):
    found = fit_scaling(SIZES, planted(exponent, fixed))
    assert found.exponent == pytest.approx(exponent, abs=1e-5)
    assert found.fixed == pytest.approx(fixed, abs=1e-4)
    assert found.low <= found.exponent <= found.high
    # A relative error of 1e-9 per cost, the least that is told apart, over the share that grows.
    assert found.high - found.low < 1e-5
    assert [found.cost(size) for size in SIZES] == pytest.approx(planted(exponent, fixed), rel=1e-6)


def test_units_change_nothing_but_the_unit():
    cost = planted(1.3, 2.0) * np.exp(0.05 * np.random.default_rng(0).normal(size=6))
    one, other = fit_scaling(SIZES, cost), fit_scaling(1e6 * SIZES, 1e-3 * cost)
    assert (other.exponent, other.low, other.high) == pytest.approx((one.exponent, one.low, one.high), abs=1e-4)
    assert other.fixed == pytest.approx(1e-3 * one.fixed, rel=1e-3)


@pytest.mark.parametrize(("exponent", "fixed"), [(1.0, 0.0), (1.0, 1.0), (2.0, 1.0), (0.7, 0.2)])
def test_interval_holds_the_planted_exponent_as_often_as_it_says(exponent, fixed):
    """Of 100 draws 95 should; less than 89 has a probability of 0.4 %, and more, where there is no fixed cost to find,
    is no fault. Of wrong exponents, one off by 0.5 is held rarely: the interval is no excuse either."""
    rng, true, wrong = np.random.default_rng(3), 0, 0
    for _ in range(100):
        found = fit_scaling(SIZES, planted(exponent, fixed) * np.exp(0.03 * rng.normal(size=6)))
        true += found.low <= exponent <= found.high
        wrong += found.low <= exponent + 0.5 <= found.high
    assert true >= 89
    assert wrong <= 10


def test_interval_without_fixed_cost_is_students():
    """Exactly 95 %: of 1,000 draws within three standard deviations, 2.1 %."""
    rng, held = np.random.default_rng(4), 0
    for _ in range(1000):
        found = fit_scaling(SIZES, 5 * np.exp(0.05 * rng.normal(size=6)), with_fixed=False)
        held += found.low <= 0 <= found.high
    assert abs(held / 1000 - 0.95) < 3 * np.sqrt(0.95 * 0.05 / 1000)


def test_a_size_counts_once_however_often_it_ran():
    """What differs from size to size does not average out over repeats: they must not narrow the interval."""
    cost = planted(1.0, 1.0) * np.exp(0.05 * np.random.default_rng(5).normal(size=6))
    once, often = fit_scaling(SIZES, cost), fit_scaling(np.repeat(SIZES, 9), np.repeat(cost, 9))
    assert (often.low, often.high) == pytest.approx((once.low, once.high), abs=1e-9)
    # One run of nine that was disturbed changes nothing: the median counts.
    disturbed = np.repeat(cost, 9)
    disturbed[::9] *= 5
    assert fit_scaling(np.repeat(SIZES, 9), disturbed).exponent == pytest.approx(once.exponent, abs=1e-9)


def test_a_line_in_logarithms_alone_would_call_it_slower():
    """What the fixed cost is for: without one, a linear cost beside a start-up seems to grow with 0.5."""
    cost = planted(1.0, 20.0)
    assert fit_scaling(SIZES, cost).verdict(1.0) == "as predicted"
    naive = fit_scaling(SIZES, cost, with_fixed=False)
    assert naive.exponent < 0.5 and not naive.low <= 1.0 <= naive.high


def test_cost_that_does_not_grow():
    flat = np.full(6, 2.0)
    assert fit_scaling(SIZES, flat, with_fixed=False).exponent == pytest.approx(0.0, abs=1e-9)
    assert fit_scaling(SIZES, flat).high < 0.01
    # Noise alone could be a power of anything that is small beside the fixed cost: nothing is told.
    noisy = fit_scaling(SIZES, flat * np.exp(0.02 * np.random.default_rng(6).normal(size=6)))
    assert noisy.high == MOST_EXPONENT and noisy.verdict(1.0) == "cannot tell"


def test_verdicts():
    known = ScalingLaw(1.1, 1.05, 1.2, 0.0, 1.0)
    predicted = {1.1: "as predicted", 1.0: "more than predicted", 2.0: "less than predicted"}
    assert {k: known.verdict(k) for k in predicted} == predicted
    # 64^0.05 is 1.23, which is more than a tenth; 6^0.05 is 1.09, which is not.
    assert (known.verdict(1.0, 64.0), known.verdict(1.0, 6.0)) == ("more than predicted", "as predicted")
    assert known.verdict(1.25, 6.0) == "as predicted" and known.verdict(1.5, 6.0) == "less than predicted"
    assert ScalingLaw(1.1, 0.5, 1.6, 0.0, 1.0).verdict(1.0) == "cannot tell"


@pytest.mark.parametrize(
    ("size", "cost", "message"),
    [
        ([1, 2, 4], [1, 2, 4], "sizes: expected at least 4 different ones, found 3"),
        ([8] * 6, [1, 2, 3, 4, 5, 6], "sizes: expected at least 4 different ones, found 1"),
        ([1, 2, 4, 8], [1, 2, 0, 4], "cost: expected positive finite numbers"),
        ([1, 2, 4, 8], [1, 2, np.nan, 4], "cost: expected positive finite numbers"),
        ([-1, 2, 4, 8], [1, 2, 3, 4], "size: expected positive finite numbers"),
    ],
)
def test_what_cannot_be_fitted_is_said(size, cost, message):
    with pytest.raises(ValueError, match=message):
        fit_scaling(np.array(size, float), np.array(cost, float))
