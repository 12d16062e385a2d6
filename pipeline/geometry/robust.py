"""Cauchy's robust loss."""

from __future__ import annotations

import numpy as np

CAUCHY = 2.3849
"""Cauchy's c in standard deviations: 95 % efficient on clean Gaussian noise (Holland and Welsch 1977)."""


def cauchy(squared: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cost and weight of whitened squared residuals."""
    ratio = squared / CAUCHY**2
    return 0.5 * CAUCHY**2 * np.log1p(ratio), 1 / (1 + ratio)
