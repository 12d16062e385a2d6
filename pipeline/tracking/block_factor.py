"""Factors of blocks, to precondition conjugate gradients with.

Their rounding costs an iteration, and no accuracy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from jaxtyping import Float, Float64


@dataclass(frozen=True)
class BlockFactor:
    """Cholesky factor of a symmetric positive definite block.

    In float32, which takes half as long, of the block scaled to a diagonal of ones; in float64 if that fails.
    """

    lower: Float[np.ndarray, "unknowns unknowns"]
    scale: Float64[np.ndarray, " unknowns"]

    @classmethod
    def of(cls, block: Float64[np.ndarray, "unknowns unknowns"]) -> BlockFactor:
        """Factorise a block."""
        scale = 1 / np.sqrt(np.where(np.diag(block) > 0, np.diag(block), 1.0))
        scaled = block * scale[:, None] * scale
        try:
            single = scaled.astype(np.float32)
            lower, _ = scipy.linalg.cho_factor(single, lower=True, overwrite_a=True, check_finite=False)
        except np.linalg.LinAlgError:
            lower, _ = scipy.linalg.cho_factor(scaled, lower=True, check_finite=False)
        return cls(lower, scale)

    def solve(self, row: Float64[np.ndarray, " unknowns"]) -> Float64[np.ndarray, " unknowns"]:
        """Multiply a vector with the block's inverse."""
        # For a single vector a sixth of the time of cho_solve, which is made for many.
        solve = scipy.linalg.get_blas_funcs("trsv", (self.lower,))
        half = solve(self.lower, (self.scale * row).astype(self.lower.dtype), lower=1)
        return self.scale * solve(self.lower, half, lower=1, trans=1)
