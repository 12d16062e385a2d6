"""Robust non-linear least squares with Gaussian priors.

For problems of up to a few thousand parameters.

Levenberg-Marquardt on iteratively reweighted residuals (Triggs et al. 2000, sections 3.3 and 4.3). The loss is
Cauchy's, whose influence falls with the error, so that a gross mistake does not count at all; its scale is not a
setting but the noise itself, estimated in every iteration from the median length of the residuals.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.sparse
import scipy.special
from jaxtyping import Float64

CAUCHY = 2.3849
"""Scale of the Cauchy loss in standard deviations: 95 % efficient on Gaussian noise (Holland and Welsch 1977)."""

CONVERGED = 1e-10
"""Relative decrease of the cost that counts as none: far below any change that a standard deviation could see."""

MAX_ITERATIONS = 200
DAMPING_START, DAMPING_LEAST, DAMPING_MOST = 1e-3, 1e-12, 1e12

Jacobian = scipy.sparse.sparray | scipy.sparse.spmatrix | np.ndarray
Evaluate = Callable[[np.ndarray], tuple[np.ndarray, Jacobian]]


@dataclass(frozen=True)
class Solution:
    """The minimum.

    Attributes:
        parameters: where the cost is least.
        covariance: of the parameters, for the estimated noise.
        residual: per observation, in its own units.
        weight: of each observation in the last iteration: 1 = fully counted, 0 = ignored.
        sigma: standard deviation of one residual component.
    """

    parameters: Float64[np.ndarray, " parameters"]
    covariance: Float64[np.ndarray, "parameters parameters"]
    residual: Float64[np.ndarray, "observations components"]
    weight: Float64[np.ndarray, " observations"]
    sigma: float


def robust_sigma(residual: Float64[np.ndarray, "observations components"], least: float, fitted: int = 0) -> float:
    """Standard deviation of one component from the median residual length; at least `least`.

    `fitted` parameters shrink the residuals: sqrt(numbers / (numbers - fitted)) undoes it.
    """
    components = residual.shape[1]
    median_of_chi = np.sqrt(2 * scipy.special.gammaincinv(components / 2, 0.5))
    shrunk = np.sqrt(residual.size / max(residual.size - fitted, 1))
    return float(max(np.median(np.linalg.norm(residual, axis=1)) / median_of_chi * shrunk, least))


def solve_least_squares(
    evaluate: Evaluate,
    start: Float64[np.ndarray, " parameters"],
    least_sigma: float,
    prior_mean: Float64[np.ndarray, " parameters"] | None = None,
    prior_sigma: Float64[np.ndarray, " parameters"] | None = None,
) -> Solution:
    """Minimise sum Cauchy(|residual| / sigma) + sum ((parameter - mean) / prior sigma)^2.

    Args:
        evaluate: parameters to (residual [observations, components], its Jacobian [observations * components,
            parameters], dense or sparse).
        least_sigma: lower bound of the noise, in the residuals' units: keeps perfect data from dividing by zero.
        prior_sigma: infinite (the default) where nothing is known beforehand.
    """
    x = start.copy()
    mean = x.copy() if prior_mean is None else prior_mean
    precision = np.zeros_like(x) if prior_sigma is None else 1.0 / np.square(prior_sigma)
    damping = DAMPING_START
    residual, jacobian = evaluate(x)
    for _ in range(MAX_ITERATIONS):
        sigma = robust_sigma(residual, least_sigma, len(x))
        normal, gradient = _normal_equations(residual, jacobian, sigma, precision, x - mean)
        cost = _cost(residual, sigma, precision, x - mean)
        while damping < DAMPING_MOST:
            step = _damped_step(normal, gradient, damping)
            if step is not None:
                new_residual, new_jacobian = evaluate(x + step)
                new_cost = _cost(new_residual, sigma, precision, x + step - mean)
                if new_cost <= cost:
                    break
            damping *= 10
        else:
            break
        x, residual, jacobian = x + step, new_residual, new_jacobian
        damping = max(damping / 10, DAMPING_LEAST)
        if cost - new_cost <= CONVERGED * cost:
            break
    sigma = robust_sigma(residual, least_sigma, len(x))
    normal, _ = _normal_equations(residual, jacobian, sigma, precision, x - mean)
    return Solution(x, _covariance(normal), residual, cauchy_weights(residual, sigma), sigma)


def _damped_step(normal: np.ndarray, gradient: np.ndarray, damping: float) -> np.ndarray | None:
    """Marquardt's step: damping in units of each parameter's own curvature, so that metres and pixels may mix."""
    scale = np.sqrt(np.maximum(np.diag(normal), np.finfo(float).tiny))
    scaled = normal / np.outer(scale, scale) + damping * np.eye(len(scale))
    try:
        return -scipy.linalg.cho_solve(scipy.linalg.cho_factor(scaled), gradient / scale) / scale
    except scipy.linalg.LinAlgError:  # not positive definite: an open direction, which more damping closes
        return None


def _covariance(normal: np.ndarray) -> np.ndarray:
    """The inverse. A direction that nothing determines gets a variance that is huge but finite, never zero."""
    scale = np.sqrt(np.maximum(np.diag(normal), np.finfo(float).tiny))
    value, vector = scipy.linalg.eigh(normal / np.outer(scale, scale))
    value = np.maximum(value, len(value) * np.finfo(float).eps * value[-1])
    with np.errstate(over="ignore"):  # infinite for a parameter that no residual depends on
        return (vector / value) @ vector.T / np.outer(scale, scale)


def cauchy(squared: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cost and weight of whitened squared residuals."""
    ratio = squared / CAUCHY**2
    return 0.5 * CAUCHY**2 * np.log1p(ratio), 1 / (1 + ratio)


def cauchy_weights(
    residual: Float64[np.ndarray, "observations components"], sigma: float
) -> Float64[np.ndarray, " observations"]:
    """Weight of each residual vector under Cauchy's loss: 1 / (1 + |r|^2 / (CAUCHY sigma)^2)."""
    return 1.0 / (1.0 + (residual**2).sum(1) / (CAUCHY * sigma) ** 2)


def _cost(residual: np.ndarray, sigma: float, precision: np.ndarray, offset: np.ndarray) -> float:
    squared = (residual**2).sum(1) / (CAUCHY * sigma) ** 2
    cost = CAUCHY**2 * np.log1p(squared).sum() + (precision * offset**2).sum()
    return float(cost) if np.isfinite(cost) else np.inf


def _normal_equations(
    residual: np.ndarray, jacobian: Jacobian, sigma: float, precision: np.ndarray, offset: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Weighted J^T J + prior precision, and the gradient."""
    weight = np.repeat(cauchy_weights(residual, sigma), residual.shape[1]) / sigma**2
    if isinstance(jacobian, np.ndarray):
        weighted = weight[:, None] * jacobian
        normal = jacobian.T @ weighted
    else:
        matrix = scipy.sparse.csr_array(jacobian)
        weighted = matrix.copy()
        weighted.data *= np.repeat(weight, np.diff(matrix.indptr))
        normal = (matrix.T @ weighted).toarray()
    return normal + np.diag(precision), weighted.T @ residual.ravel() + precision * offset
