"""Rotations by angles near 0 and pi, and quaternions of no length, against mpmath."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
import torch

from pipeline.geometry.rotations import (
    left_jacobian,
    matrix_from_quaternion,
    matrix_from_rotation_vector,
    quaternion_from_matrix,
    rotation_vector_from_matrix,
    rotation_vector_from_quaternion,
    skew,
    slerp,
)
from tests.support.naive.motions import naive_jacobian_factor, naive_log, naive_quaternion
from tests.support.results.hard_case import HardCase, worst

ROUNDING = 1e-14
"""A few dozen float64 operations on numbers of about one."""

AXIS = np.array([2.0, -1.0, 2.0]) / 3
SMALL = [1e-300, 1e-12, 1e-8, 1e-4]
NEAR_HALF_TURN = [1e-4, 1e-8, 0.0]
"""How far from pi."""


def exact_matrix(vector: np.ndarray) -> mpmath.matrix:
    """The exponential of the cross product, as a series to 60 digits."""
    with mpmath.workdps(60):
        return mpmath.expm(mpmath.matrix([[mpmath.mpf(float(x)) for x in row] for row in skew(vector)]), "taylor")


def numbers(matrix: mpmath.matrix) -> np.ndarray:
    return np.array(matrix.tolist(), dtype=float)


@pytest.mark.parametrize("angle", SMALL)
def test_exponential_of_a_small_angle(case: HardCase, angle: float) -> None:
    vector = angle * AXIS
    found, exact = matrix_from_rotation_vector(vector), exact_matrix(vector)
    with mpmath.workdps(60):
        turning = exact - exact.T
    # As small as the angle: relative to itself.
    case.check(worst(found - found.T, numbers(turning)), ROUNDING)
    if 1e-200 < angle < 1e-6:  # the identity for what is as good as none, as it is often written
        case.naive_fails(worst(np.zeros((3, 3)), numbers(turning)))
    if angle < 1e-200:  # whose square is zero
        with np.errstate(invalid="ignore", divide="ignore"):
            length = np.sqrt((vector**2).sum())
            cross = skew(vector / length)
            naive = np.eye(3) + np.sin(length) * cross + (1 - np.cos(length)) * cross @ cross
        case.naive_fails(worst(naive - naive.T, numbers(turning)))


@pytest.mark.parametrize("angle", SMALL)
def test_logarithm_of_a_small_angle(case: HardCase, angle: float) -> None:
    """From the closest matrix of float64."""
    vector = angle * AXIS
    matrix = numbers(exact_matrix(vector))
    case.check(worst(rotation_vector_from_matrix(matrix), vector), 10 * ROUNDING)
    if angle < 1e-7:
        with np.errstate(invalid="ignore", divide="ignore"):
            case.naive_fails(worst(naive_log(matrix), vector))


@pytest.mark.parametrize("short", NEAR_HALF_TURN)
def test_logarithm_near_a_half_turn(case: HardCase, short: float) -> None:
    vector = (np.pi - short) * AXIS
    matrix = numbers(exact_matrix(vector))
    found = rotation_vector_from_matrix(matrix)
    error = min(worst(found, sign * vector) for sign in ((1, -1) if short == 0 else (1,)))
    case.check(error, 10 * ROUNDING)
    with np.errstate(invalid="ignore", divide="ignore"):
        naive = naive_log(matrix)
    case.naive_fails(min(worst(naive, sign * vector) for sign in ((1, -1) if short == 0 else (1,))))


@pytest.mark.parametrize("short", NEAR_HALF_TURN)
def test_quaternion_near_a_half_turn(case: HardCase, short: float) -> None:
    angle = mpmath.mpf(np.pi - short)
    matrix = numbers(exact_matrix((np.pi - short) * AXIS))
    exact = [mpmath.cos(angle / 2), *(mpmath.sin(angle / 2) * mpmath.mpf(float(x)) for x in AXIS)]
    case.check(worst(quaternion_from_matrix(matrix), exact), ROUNDING)
    with np.errstate(invalid="ignore", divide="ignore"):
        case.naive_fails(worst(naive_quaternion(matrix), exact))


@pytest.mark.parametrize("angle", [*SMALL, 0.0, 9.9e-3, np.pi])
def test_derivative_of_the_exponential(case: HardCase, angle: float) -> None:
    """J = sum [v]x^n / (n + 1)!, against the series. The usual formula divides 1 - cos by the angle squared."""
    vector = angle * AXIS
    with mpmath.workdps(60):
        cross = mpmath.matrix([[mpmath.mpf(float(x)) for x in row] for row in skew(vector)])
        series, term = mpmath.zeros(3), mpmath.eye(3)
        for n in range(60):
            series, term = series + term, term * cross / (n + 2)
    case.check(gradient_error=worst(left_jacobian(vector), numbers(series)), gradient_bound=1e-10)
    if angle < 1e-3:
        with np.errstate(invalid="ignore", divide="ignore"):
            naive = naive_jacobian_factor(angle)
        case.naive_fails(worst(naive, 0.5), "gradient")  # the factor of [v]x, a half up to angle^2 / 24


@pytest.mark.parametrize("length", [0.0, 1e-5, 1e6])
def test_matrix_of_a_quaternion_of_any_length(case: HardCase, length: float) -> None:
    q = (length * torch.tensor([0.5, -0.5, 0.7, 0.1])).requires_grad_()
    found = matrix_from_quaternion(q)
    (slope,) = torch.autograd.grad(found[0, 1], q)

    def entry(*components: mpmath.mpf) -> mpmath.mpf:
        w, x, y, z = components
        return 2 * (x * y - w * z) / (w * w + x * x + y * y + z * z)

    at = [mpmath.mpf(x) for x in q.tolist()]
    w, x, y, z = at
    if length:
        n = w * w + x * x + y * y + z * z
        exact = [
            [1 - 2 * (y * y + z * z) / n, 2 * (x * y - w * z) / n, 2 * (x * z + w * y) / n],
            [2 * (x * y + w * z) / n, 1 - 2 * (x * x + z * z) / n, 2 * (y * z - w * x) / n],
            [2 * (x * z - w * y) / n, 2 * (y * z + w * x) / n, 1 - 2 * (x * x + y * y) / n],
        ]
        with mpmath.workdps(60):
            slopes = [mpmath.diff(entry, tuple(at), tuple(int(i == k) for k in range(4))) for i in range(4)]
    else:
        exact, slopes = np.eye(3), np.zeros(4)
    case.check(worst(found, exact), 5e-7, worst(slope, slopes), 2e-6)
    if length == 1e-5:
        w, x, y, z = (q / (q.norm() + 1e-8)).tolist()  # guarded, as it is usually written
        naive = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
        case.naive_fails(worst(naive, exact))
    if length == 0:
        case.naive_fails((q / q.norm()).detach().abs().max())


@pytest.mark.parametrize("angle", [0.0, 1e-9, np.pi - 1e-6])
def test_interpolation_between_equal_and_nearly_opposite_rotations(case: HardCase, angle: float) -> None:
    half = mpmath.mpf(angle) / 2
    start, end = np.array([1.0, 0, 0, 0]), np.array([float(mpmath.cos(half)), *float(mpmath.sin(half)) * AXIS])
    exact = [mpmath.cos(0.3 * half), *(mpmath.sin(0.3 * half) * mpmath.mpf(float(x)) for x in AXIS)]
    errors = []
    for sign in (1, -1):  # of the end: the same rotation
        case.check(worst(slerp(start, sign * end, 0.3), exact), ROUNDING)
    # Of equal ones the textbook gives them as they are. Without the choice of sign it goes the long way around.
    for towards in (end, -end):
        if (between := np.arccos(start @ towards)) > 0:
            naive = (np.sin(0.7 * between) * start + np.sin(0.3 * between) * towards) / np.sin(between)
            errors.append(worst(naive, exact))
    case.naive_fails(max(errors))


@pytest.mark.parametrize("w", [0.0, -0.0, 1e-320])
def test_logarithm_of_a_half_turn_as_quaternion(case: HardCase, w: float) -> None:
    found = rotation_vector_from_quaternion(np.array([w, *AXIS]))
    case.check(min(worst(found, np.pi * AXIS), worst(found, -np.pi * AXIS)), ROUNDING)
