"""Scaling law of a cost: the exponent of a power law beside a fixed cost, with its interval.

The law is cost = fixed + factor size^exponent, each cost off by a random share: least squares of log cost. Whatever
the machine did meanwhile, and whatever the law leaves out (caches, last blocks that are half empty), differs from size
to size, so a size is what is drawn anew, not a repeat: runs of one size count as one, their median. The interval holds
all exponents that an F-test does not reject, each with the fixed cost and factor that suit it best: a profile of the
likelihood (Seber and Wild, Nonlinear Regression, section 5.4), which stays right where the fixed cost reaches zero.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float64
from scipy.optimize import brentq, minimize_scalar
from scipy.stats import f as fisher
from scipy.stats import t as student

MOST_EXPONENT = 4.0
"""Largest that is looked for beside a fixed cost; nothing here grows faster than a dense matrix is factorised, 3."""

GRID = 81
"""Exponents of the first search: steps of 0.05, in each of which the misfit has one minimum at most."""

SHARES = 1 / (1 + np.exp(-np.append(np.linspace(-12, 12, 97), np.inf)))
"""Shares of the growing part at the middle size that are tried first: 6e-6 to 1."""

STEPS = np.linspace(0, 1, 33)
"""Of the shares between the neighbours of the best, in a zoom."""

ZOOMS = 7
"""Searches of a share, each but the first sixteen times as fine as the one before: to 1e-9 of it."""

ROUNDING = 1e-9
"""Relative error of a cost below which nothing is a misfit; times are written with as many digits."""

TELLING = 1.0
"""Width of an interval beyond which nothing is told: it holds two whole exponents."""

IMMATERIAL = 0.1
"""Share of a cost that no prediction is about: the same run takes as much more or less beside other neighbours on the
machine (measured: 15 %), and memory differs by what the allocator happens to keep."""

Verdict = Literal["as predicted", "less than predicted", "more than predicted", "cannot tell"]


@dataclass(frozen=True)
class ScalingLaw:
    """cost = fixed + factor size^exponent.

    Attributes:
        low, high: interval of the exponent; 0 or `MOST_EXPONENT` where the search ended.
        fixed: what does not grow, in the unit of the cost.
    """

    exponent: float
    low: float
    high: float
    fixed: float
    factor: float

    def cost(self, size: float) -> float:
        """Cost at a size by the law, in the unit of the costs it was fitted to."""
        return self.fixed + self.factor * size**self.exponent

    def verdict(self, predicted: float, span: float = math.inf) -> Verdict:
        """Verdict on a predicted exponent: inside the interval, below it or above.

        Args:
            span: largest over smallest size. A miss that makes less than `IMMATERIAL` of the cost from one to the other
                is none; over an endless span every miss is one.
        """
        slack = math.log1p(IMMATERIAL) / math.log(span)
        if self.high - self.low > TELLING:
            return "cannot tell"
        if self.low - slack <= predicted <= self.high + slack:
            return "as predicted"
        return "less than predicted" if predicted > self.high else "more than predicted"


def fit_scaling(
    size: Float64[np.ndarray, " runs"],
    cost: Float64[np.ndarray, " runs"],
    with_fixed: bool = True,
    level: float = 0.95,
) -> ScalingLaw:
    """Fit the law.

    Args:
        size: of each run, positive; runs of one size are its repeats.
        cost: positive, in any unit.
        with_fixed: whether there may be a fixed cost. A cost that is expected not to grow is fitted without: a fixed
            cost is all there is of it.
        level: of the interval.

    Raises:
        ValueError: if sizes are too few to leave a degree of freedom, or a number is not positive and finite.
    """
    z, y, middle = _medians(size, cost, unknowns=3 if with_fixed else 2)
    return _profile(z, y, middle, level) if with_fixed else _line(np.log(z), y, middle, level)


def _medians(size: np.ndarray, cost: np.ndarray, unknowns: int) -> tuple[np.ndarray, np.ndarray, float]:
    """The different sizes over their geometric mean, log of the median cost of each, and that mean."""
    size, cost = np.asarray(size, np.float64), np.asarray(cost, np.float64)
    sizes = np.unique(size)
    if len(sizes) <= unknowns:
        raise ValueError(f"sizes: expected at least {unknowns + 1} different ones, found {len(sizes)}")
    for name, values in (("size", size), ("cost", cost)):
        if not (np.isfinite(values) & (values > 0)).all():
            raise ValueError(f"{name}: expected positive finite numbers, found {values.tolist()}")
    middle = float(np.exp(np.log(sizes).mean()))
    return sizes / middle, np.log([np.median(cost[size == each]) for each in sizes]), middle


def _law(
    exponent: float, low: float, high: float, share: float, z: np.ndarray, y: np.ndarray, middle: float
) -> ScalingLaw:  # fmt: skip
    """From the share of the growing part at the middle size."""
    scale = float(np.exp((y - np.log1p(share * np.expm1(exponent * np.log(z)))).mean()))
    return ScalingLaw(exponent, low, high, scale * (1 - share), scale * share / middle**exponent)


def _line(x: np.ndarray, y: np.ndarray, middle: float, level: float) -> ScalingLaw:
    """The power law alone: a line in logarithms, with Student's interval."""
    exponent = float(x @ y / (x @ x))
    left = y - y.mean() - exponent * x
    error = np.sqrt(left @ left / (len(x) - 2) / (x @ x))
    half = float(student.ppf((1 + level) / 2, len(x) - 2) * error) + ROUNDING
    return ScalingLaw(exponent, exponent - half, exponent + half, 0.0, float(np.exp(y.mean()) / middle**exponent))


def _best_share(exponent: float, z: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """The share of the growing part at the middle size that suits an exponent best, and the misfit: the sum of squares
    for cost = c (1 - share + share z^exponent) with the best c."""
    shares, grown = SHARES, np.expm1(exponent * np.log(z))
    for _ in range(ZOOMS):
        left = y - np.log1p(shares[:, None] * grown)
        left -= left.sum(1, keepdims=True) / len(z)
        misfit = np.einsum("sz,sz->s", left, left)
        best = int(misfit.argmin())
        share, least = float(shares[best]), float(misfit[best])
        low, high = shares[max(best - 1, 0)], shares[min(best + 1, len(shares) - 1)]
        shares = low + (high - low) * STEPS
    return share, least


def _profile(z: np.ndarray, y: np.ndarray, middle: float, level: float) -> ScalingLaw:
    """The law with a fixed cost, and the exponents that an F-test lets pass."""

    def misfit(exponent: float) -> float:
        return _best_share(exponent, z, y)[1]

    grid = np.linspace(0, MOST_EXPONENT, GRID)
    tried = np.array([misfit(k) for k in grid])
    best = int(tried.argmin())
    around = grid[max(best - 1, 0)], grid[min(best + 1, GRID - 1)]
    found = minimize_scalar(misfit, bounds=around, method="bounded", options={"xatol": 1e-9})
    least, exponent = min((float(found.fun), float(found.x)), (float(tried[best]), float(grid[best])))
    degrees = len(z) - 3
    limit = least * (1 + fisher.ppf(level, 1, degrees) / degrees) + len(z) * ROUNDING**2
    low = _crossing(misfit, limit, exponent, grid[grid < exponent][::-1])
    high = _crossing(misfit, limit, exponent, grid[grid > exponent])
    return _law(exponent, low, high, _best_share(exponent, z, y)[0], z, y, middle)


def _crossing(misfit: Callable[[float], float], limit: float, start: float, outward: np.ndarray) -> float:
    """The exponent, going outward from `start`, at which the misfit exceeds the limit; the last one if none does."""
    inside = start
    for k in outward.tolist():
        if misfit(k) > limit:
            return float(brentq(lambda at: misfit(at) - limit, *sorted((inside, k)), xtol=1e-9))
        inside = k
    return inside
