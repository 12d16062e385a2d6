"""Least squares of coefficients that many texels share, judged on other texels."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float64, Int64
from scipy.optimize import nnls

Solver = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""From target [n, 1, 3] and columns [n, k, 3] to coefficients [k, 3]."""


def each(
    groups: Sequence[Int64[np.ndarray, " _"]], solve: Solver, target: np.ndarray, columns: np.ndarray
) -> Float64[np.ndarray, "n k 3"]:
    """Coefficients for every row, found on the group of rows that it is in.

    Regions may be of different materials.
    """
    found = np.zeros(columns.shape)
    for rows in groups:
        found[rows] = solve(target[rows], columns[rows])
    return found


def solve_shared(target: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Coefficients of 0 or more, the same for all colours."""
    stacked = columns.swapaxes(1, 2).reshape(-1, columns.shape[1])
    q, r = np.linalg.qr(stacked)
    return np.repeat(nnls(r, q.T @ target.swapaxes(1, 2).ravel())[0][:, None], 3, 1)


def solve_apart(target: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Coefficients of 0 or more, each colour its own.

    Light from below the surface adds to what a texel shows: free signs explain a plastic's coat with it, which takes
    light away where it grazes.
    """
    coefficients = np.zeros(columns.shape[1:])
    for c in range(3):
        q, r = np.linalg.qr(columns[..., c])
        coefficients[:, c] = nnls(r, q.T @ target[:, 0, c])[0]
    return coefficients


def crossed(target: np.ndarray, columns: np.ndarray, point: np.ndarray, solve: Solver) -> float:
    """Mean square of what is left of the target by coefficients of the other half of the texels."""
    error = 0.0
    for half in (0, 1):
        mine = point % 2 == half
        left = target[~mine, 0] - (columns[~mine] * solve(target[mine], columns[mine])).sum(1)
        error += float((left**2).sum())
    return error / target.size
