"""Rigid alignment of point sets with outliers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from pipeline.geometry.least_squares import cauchy_weights, robust_sigma

ITERATIONS = 100
CONVERGED = 1e-12
"""Largest change of a rotation entry at which reweighting stops: rounding only."""

LEAST_SPREAD = 1e-3
"""Second singular value over the first of a point set that is not a line."""

SCALE_ROUNDS = 3
"""Rounds of aligning and scaling: the motion does not depend on the scale but through the weights."""


@dataclass(frozen=True)
class Alignment:
    """target = R @ source + t.

    Attributes:
        residual: moved source minus target, in the points' unit.
        weight: of each pair, 1 = fully counted.
        sigma: standard deviation of one residual component.
    """

    R: Float64[np.ndarray, "3 3"]
    t: Float64[np.ndarray, "3"]
    residual: Float64[np.ndarray, "points 3"]
    weight: Float64[np.ndarray, " points"]
    sigma: float

    def apply(self, points: Float64[np.ndarray, "*batch 3"]) -> Float64[np.ndarray, "*batch 3"]:
        """The points, moved."""
        return points @ self.R.T + self.t


def align_rigid(
    source: Float64[np.ndarray, "points 3"], target: Float64[np.ndarray, "points 3"], least_sigma: float = 1e-9
) -> Alignment:
    """Rotation and translation that bring `source` onto `target`, robust to outliers.

    No scale, no mirror.

    Kabsch (1976) with the determinant of Umeyama (1991), reweighted by Cauchy's loss from the coordinatewise start
    of an L1 fit: weights begin at 1 / distance, so that a third of wrong pairs does not decide where it begins.

    Raises:
        ValueError: if there are fewer than three pairs or they lie on one line.
    """
    if len(source) < 3 or min(_flatness(source), _flatness(target)) < LEAST_SPREAD:
        raise ValueError("a rigid alignment needs three pairs of points that do not lie on one line")
    R, t = _kabsch(source, target, np.ones(len(source)))
    for weigh in (_l1_weights, cauchy_weights):
        for _ in range(ITERATIONS):
            residual = source @ R.T + t - target
            sigma = robust_sigma(residual, least_sigma)
            before = R
            R, t = _kabsch(source, target, weigh(residual, sigma))
            if np.abs(R - before).max() < CONVERGED:
                break
    residual = source @ R.T + t - target
    sigma = robust_sigma(residual, least_sigma)
    return Alignment(R, t, residual, cauchy_weights(residual, sigma), sigma)


def fit_scale(
    source: Float64[np.ndarray, "points 3"], target: Float64[np.ndarray, "points 3"]
) -> tuple[float, float]:  # fmt: skip
    """Ratio of the sizes of `target` and `source`, and its standard deviation.

    From the median ratio of distances between points, which needs no motion and bears a quarter of wrong pairs, to the
    robust similarity (Umeyama 1991).

    Raises:
        ValueError: as `align_rigid` does.
    """
    first, second = np.triu_indices(len(source), 1)
    before, after = (np.linalg.norm(points[first] - points[second], axis=1) for points in (source, target))
    scale = float(np.median(after[before > 0] / before[before > 0])) if (before > 0).any() else 1.0
    for _ in range(SCALE_ROUNDS):
        scaled = scale * source
        alignment = align_rigid(scaled, target)
        weight = alignment.weight[:, None]
        centered, goal = (points - (weight * points).sum(0) / weight.sum() for points in (scaled, target))
        inertia = float((weight * centered**2).sum())
        scale *= float((weight * (centered @ alignment.R.T) * goal).sum()) / inertia
    return scale, scale * alignment.sigma / np.sqrt(inertia)


def _flatness(points: np.ndarray) -> float:
    spread = np.linalg.svd(points - points.mean(0), compute_uv=False)
    return float(spread[1] / spread[0]) if spread[0] > 0 else 0.0


def _l1_weights(residual: np.ndarray, sigma: float) -> np.ndarray:
    # Capped at a tenth of the noise: there L1 and L2 cannot be told apart, and nothing is divided by zero.
    return 1.0 / np.maximum(np.linalg.norm(residual, axis=1), 0.1 * sigma)


def _kabsch(source: np.ndarray, target: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    w = (weight / weight.sum())[:, None]
    source_mean, target_mean = (w * source).sum(0), (w * target).sum(0)
    U, _, Vt = np.linalg.svd((w * (target - target_mean)).T @ (source - source_mean))
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return R, target_mean - R @ source_mean
