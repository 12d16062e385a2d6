"""Tails and quantiles are those of scipy.stats."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from pipeline.base import distributions

FREEDOM = (1, 3, 12.5, 400)


@pytest.mark.parametrize("freedom", FREEDOM)
@pytest.mark.parametrize("value", [-0.1, 0.0, 0.3, 2.0, 25.0, np.inf, np.nan])
def test_tails_are_those_of_scipy(value, freedom):
    np.testing.assert_array_equal(distributions.chi2_tail(value, freedom), stats.chi2.sf(value, freedom))
    np.testing.assert_array_equal(distributions.f_tail(value, freedom, 7), stats.f.sf(value, freedom, 7))
    np.testing.assert_array_equal(distributions.student_tail(value, freedom), stats.t.sf(value, freedom))


@pytest.mark.parametrize("freedom", FREEDOM)
@pytest.mark.parametrize("probability", [0.01, 0.5, 0.975])
def test_quantiles_are_those_of_scipy(probability, freedom):
    assert distributions.f_quantile(probability, freedom, 7) == stats.f.ppf(probability, freedom, 7)
    assert distributions.student_quantile(probability, freedom) == stats.t.ppf(probability, freedom)
