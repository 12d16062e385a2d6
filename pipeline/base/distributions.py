"""Tails and quantiles of chi-square, F and Student's t distribution.

`scipy.stats` has them, and takes half a second to import; these are the functions of `scipy.special` that it calls.
"""

from __future__ import annotations

from scipy import special

Real = int | float


def chi2_tail(value: Real, freedom: Real) -> float:
    """Probability of more than `value`."""
    return float(special.chdtrc(freedom, max(value, 0.0)))


def f_tail(value: Real, freedom: Real, rest_freedom: Real) -> float:
    """Probability of more than `value`; degrees of freedom of numerator and denominator."""
    return float(special.fdtrc(freedom, rest_freedom, max(value, 0.0)))


def f_quantile(probability: float, freedom: Real, rest_freedom: Real) -> float:
    """Value that is exceeded with 1 - `probability`."""
    return float(special.fdtri(freedom, rest_freedom, probability))


def student_tail(value: Real, freedom: Real) -> float:
    """Probability of more than `value`, on one side."""
    return float(special.stdtr(freedom, -value))


def student_quantile(probability: float, freedom: Real) -> float:
    """Value that is exceeded with 1 - `probability`."""
    return float(special.stdtrit(freedom, probability))
