"""Linear least squares on errors of pictures of the avatar, solved on halves of the images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float64

DARK = 0.02
"""Linear RGB added to a pixel before errors are taken relative to its root: near black, noise does not fall further."""

SATURATED = 0.98
"""Linear RGB from which a captured pixel may have been cut off."""

REDUNDANCY = 25.0
"""Pixels that count as one: neighbours share a texel, a shadow's edge, a highlight."""

TIGHTER = (1, 2, 4, 8, 16, 32)
"""How much tighter than stated the priors are that are tried."""

CAUCHY = 3.0
"""Residuals of so many standard deviations count half."""

NORMAL_MAD = 1.4826
"""Standard deviation of normal numbers over the median of their absolute values."""

Sigma = float | np.ndarray


@dataclass(frozen=True)
class PictureEquations:
    """Normal equations of changes of some unknowns, of each half of the images.

    Attributes:
        matrix: A.
        vector: b: the error of a half is lower by 2 x.b - x.A x for changes x.
        errors: squared errors of each half, weighted as the equations are.
    """

    matrix: Float64[np.ndarray, "2 unknowns unknowns"]
    vector: Float64[np.ndarray, "2 unknowns"]
    errors: Float64[np.ndarray, " 2"]

    @staticmethod
    def none(unknowns: int) -> PictureEquations:
        """Equations of no images."""
        return PictureEquations(np.zeros((2, unknowns, unknowns)), np.zeros((2, unknowns)), np.zeros(2))

    def add(
        self,
        half: int,
        matrix: np.ndarray,
        vector: np.ndarray,
        errors: float,
        which: Sequence[int] | slice = slice(None),
    ) -> None:
        """Add those of images of one half, on some of the unknowns.

        An unknown that is named twice, as of two lights in one place, gets the sum of both.
        """
        at = np.arange(self.vector.shape[1])[which]
        np.add.at(self.matrix[half], np.ix_(at, at), matrix)
        np.add.at(self.vector[half], at, vector)
        self.errors[half] += errors

    def of(self, which: slice) -> PictureEquations:
        """Equations of some unknowns, where the others do not change."""
        return PictureEquations(self.matrix[:, which, which], self.vector[:, which], self.errors)

    def solve(self, halves: Sequence[int], sigma: Sigma) -> Float64[np.ndarray, " unknowns"]:
        """Changes that fit the given halves, of which `sigma` is expected, of each or of all."""
        matrix, vector = self.matrix[list(halves)].sum(0), self.vector[list(halves)].sum(0)
        return np.linalg.solve(matrix + np.diag(np.broadcast_to(1 / np.square(sigma), vector.shape)), vector)

    def gain(self, changes: Float64[np.ndarray, " unknowns"], half: int) -> float:
        """Squared errors of a half that changes take away."""
        return float(2 * changes @ self.vector[half] - changes @ self.matrix[half] @ changes)

    def foretold(self, sigma: Sigma) -> float:
        """Squared errors that changes fitted to one half take away from the other, of both."""
        return sum(self.gain(self.solve([1 - half], sigma), half) for half in range(2))


def image_equations(
    changes: Float[np.ndarray, "unknowns pixels 3"], rendered: Float[np.ndarray, "pixels 3"],
    captured: Float[np.ndarray, "pixels 3"],
) -> tuple[Float64[np.ndarray, "unknowns unknowns"], Float64[np.ndarray, " unknowns"], float]:  # fmt: skip
    """Matrix, vector and squared errors of one image.

    Args:
        changes: of linear RGB of the subject's pixels with each unknown.
        rendered: as the avatar has them.
        captured: as the camera saw them.
    """
    rows = changes.reshape(len(changes), -1).astype(np.float64)
    seen, expected = captured.reshape(-1).astype(np.float64), rendered.reshape(-1).astype(np.float64)
    rows, seen, expected = (array[..., seen < SATURATED] for array in (rows, seen, expected))
    scale = 1 / np.sqrt(DARK + expected.clip(0))  # The sRGB curve and photon noise both go about as the root.
    rows, residual = rows * scale, (seen - expected) * scale
    deviation = NORMAL_MAD * np.median(np.abs(residual)) if residual.size else 0.0
    if not deviation > 0:
        return np.zeros((len(rows), len(rows))), np.zeros(len(rows)), 0.0
    weight = 1 / (1 + (residual / (CAUCHY * deviation)) ** 2) / (REDUNDANCY * deviation**2)
    return (rows * weight) @ rows.T, (rows * weight) @ residual, float((weight * residual**2).sum())
