"""Rotations as textbooks have them."""

from __future__ import annotations

import numpy as np


def naive_log(matrix: np.ndarray) -> np.ndarray:
    """Rotation vector: angle from the trace, axis from the antisymmetric part over its sine."""
    angle = np.arccos((np.trace(matrix) - 1) / 2)
    axis = np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]])
    return angle * axis / (2 * np.sin(angle))


def naive_quaternion(matrix: np.ndarray) -> np.ndarray:
    """Quaternion whose real part comes from the trace, and all else from the real part."""
    w = np.sqrt(1 + np.trace(matrix)) / 2
    axis = np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]])
    return np.array([w, *axis / (4 * w)])


def naive_jacobian_factor(angle: float) -> float:
    """(1 - cos a) / a^2: what [v]x is multiplied by in the derivative of the exponential."""
    return (1 - np.cos(np.float64(angle))) / (np.float64(angle) * angle)
