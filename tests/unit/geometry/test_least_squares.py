"""Robust least squares against the closed form and planted outliers."""

import numpy as np
import pytest

from pipeline.geometry.least_squares import robust_sigma, solve_least_squares


def line(abscissa, ordinate):
    design = np.stack([abscissa, np.ones_like(abscissa)], 1)
    return lambda x: ((design @ x - ordinate)[:, None], design)


def test_linear_problem_matches_normal_equations_and_covariance():
    rng = np.random.default_rng(0)
    abscissa = np.linspace(0, 1, 400)
    sigma = 0.02
    solution = solve_least_squares(
        line(abscissa, 3 * abscissa + 1 + rng.normal(0, sigma, 400)), np.zeros(2), least_sigma=1e-9
    )
    # Cov = sigma^2 (A^T A)^-1; the weights of Cauchy's loss inflate it by less than 1.5.
    design = np.stack([abscissa, np.ones_like(abscissa)], 1)
    expected = sigma * np.sqrt(np.diag(np.linalg.inv(design.T @ design)))
    assert np.all(np.abs(solution.parameters - [3, 1]) < 4 * expected)
    assert np.sqrt(np.diag(solution.covariance)) == pytest.approx(expected, rel=0.5)
    assert solution.sigma == pytest.approx(sigma, rel=0.2)


def test_a_third_of_gross_outliers_moves_nothing():
    rng = np.random.default_rng(1)
    abscissa = np.linspace(0, 1, 300)
    ordinate = 3 * abscissa + 1 + rng.normal(0, 0.01, 300)
    ordinate[::3] += rng.uniform(2, 9, 100)
    solution = solve_least_squares(line(abscissa, ordinate), np.array([2.5, 1.5]), least_sigma=1e-9)
    assert np.abs(solution.parameters - [3, 1]).max() < 0.01
    assert solution.weight[::3].max() < 1e-2 < 0.2 < np.median(solution.weight[1::3])


def test_rosenbrock():
    def evaluate(x):
        residual = np.array([[10 * (x[1] - x[0] ** 2)], [1 - x[0]]])
        return residual, np.array([[-20 * x[0], 10], [-1, 0]])

    # Least sigma far above the residuals: plain least squares.
    solution = solve_least_squares(evaluate, np.array([-1.2, 1.0]), least_sigma=1e3)
    assert solution.parameters == pytest.approx([1, 1], abs=1e-4)


def test_prior_decides_what_the_data_leave_open():
    def evaluate(x):
        return np.array([[x[0] + x[1] - 4.0]]), np.array([[1.0, 1.0]])

    mean, sigma = np.array([1.0, 1.0]), np.array([1.0, 3.0])
    solution = solve_least_squares(evaluate, np.zeros(2), 1e-4, mean, sigma)
    # The excess of 2 is shared in the ratio of the variances, 1 : 9.
    assert solution.parameters == pytest.approx([1.2, 2.8], abs=1e-5)


def test_perfect_data_are_finite():
    solution = solve_least_squares(line(np.arange(5.0), 2 * np.arange(5.0)), np.array([1.0, 1.0]), least_sigma=1e-3)
    assert solution.parameters == pytest.approx([2, 0], abs=1e-9)
    assert np.isfinite(solution.covariance).all()
    assert solution.sigma == 1e-3


@pytest.mark.parametrize("components", [1, 2, 3])
def test_robust_sigma_of_gaussian_noise(components):
    residual = np.random.default_rng(2).normal(0, 0.3, (20000, components))
    residual[:1000] = 100.0
    # 5 % of outliers push the median from the 50th to the 52.6th percentile: at most 7 %.
    assert robust_sigma(residual, 1e-9) == pytest.approx(0.3, rel=0.08)


def test_residuals_of_a_fit_tell_the_noise_before_it():
    """Half as many unknowns as numbers leave residuals smaller by sqrt(2); medians of 400 fits are good to 2 %."""
    rng, sigmas = np.random.default_rng(4), []
    for _ in range(400):
        design, noise = rng.normal(size=(40, 20)), rng.normal(0, 0.3, 40)
        left = noise - design @ np.linalg.lstsq(design, noise, rcond=None)[0]
        sigmas.append(robust_sigma(left[:, None], 1e-9, fitted=20))
    assert np.mean(sigmas) == pytest.approx(0.3, rel=0.03)
