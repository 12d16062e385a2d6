"""Poses of all frames of a chunk by one block-banded Levenberg-Marquardt problem.

The data terms see tracked points only: each returns, per point, the gradient and Gauss-Newton matrix by its world
position, which the kinematic chain then carries to the unknowns. So the cost hardly depends on the number of cameras.
The robust loss is Cauchy's, ``c^2/2 log(1 + (r / c)^2)``, by iterated reweighting.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float64

from pipeline.geometry.cameras import Camera
from pipeline.geometry.kinematics import Pose, TrackedPoints, moved, point_positions
from pipeline.geometry.least_squares import cauchy
from pipeline.geometry.rotations import quaternion_from_matrix
from pipeline.geometry.triangulation import reprojection
from pipeline.tracking.motion_prior import MotionPrior, prior_cost
from pipeline.tracking.pose_equations import PointQuadratic, normal_equations, solve_equations

START_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-9, 1e8
"""Of Levenberg-Marquardt, relative to the diagonal. Where even the most does not help, rounding has been reached."""

CONVERGED = 1e-7
"""Relative decrease of the cost that ends the iteration: a thousandth of a standard deviation at 10^4 residuals."""


DataTerm = Callable[[Float64[np.ndarray, "frames points 3"]], PointQuadratic]


def position_term(
    targets: Float64[np.ndarray, "frames points 3"], sigma_m: Float64[np.ndarray, "frames points"]
) -> DataTerm:
    """Robust distance to target positions; NaN targets are left out."""
    known = np.isfinite(targets).all(-1) & np.isfinite(sigma_m)
    precision = np.where(known, 1 / np.where(known, sigma_m, 1.0) ** 2, 0.0)

    def term(positions: np.ndarray) -> PointQuadratic:
        difference = np.where(known[..., None], positions - np.nan_to_num(targets), 0.0)
        cost, weight = cauchy(precision * (difference**2).sum(-1))
        weight = weight * precision
        return PointQuadratic(float(cost.sum()), weight[..., None] * difference, weight[..., None, None] * np.eye(3))

    return term


def reprojection_term(
    cameras: Sequence[Camera],
    observed: Float64[np.ndarray, "cameras frames points 2"],
    confidence: Float64[np.ndarray, "cameras frames points"],
    sigma_px: float,
) -> DataTerm:
    """Robust reprojection residuals of normalised coordinates, pixels, by `confidence`."""
    count, frames, points, _ = observed.shape
    flat = observed.reshape(count, -1, 2)
    seen = (np.isfinite(flat).all(-1)) & (confidence.reshape(count, -1) > 0)
    safe = np.where(seen[..., None], flat, 0.0)
    precision = np.where(seen, confidence.reshape(count, -1), 0.0) / sigma_px**2

    def term(positions: np.ndarray) -> PointQuadratic:
        length, residual, jacobian = reprojection(cameras, safe, positions.reshape(-1, 3))
        visible = seen & np.isfinite(length)
        cost, weight = cauchy(np.where(visible, precision * np.where(visible, length, 0.0) ** 2, 0.0))
        weight = np.where(visible, weight * precision, 0.0)
        gradient = np.einsum("cn,cnia,cni->na", weight, jacobian, residual, optimize=True)
        normal = np.einsum("cn,cnia,cnib->nab", weight, jacobian, jacobian, optimize=True)
        shape = (frames, points, 3)
        return PointQuadratic(float(cost.sum()), gradient.reshape(shape), normal.reshape(*shape, 3))

    return term


def joined(terms: Sequence[DataTerm], counts: Sequence[int]) -> DataTerm:
    """One term from several, each of which sees the next `counts` points."""
    ends = np.cumsum(counts)[:-1]

    def term(positions: np.ndarray) -> PointQuadratic:
        parts = [t(p) for t, p in zip(terms, np.split(positions, ends, axis=1), strict=True)]
        gradient, normal = (np.concatenate([getattr(p, name) for p in parts], 1) for name in ("gradient", "normal"))
        shared = None
        if any(p.shared is not None for p in parts):
            own = max(p.shared.shape[3] for p in parts if p.shared is not None)
            none = [np.zeros((*p.gradient.shape, own)) for p in parts]
            shared = np.concatenate([n if p.shared is None else p.shared for p, n in zip(parts, none, strict=True)], 1)
        return PointQuadratic(sum(p.cost for p in parts), gradient, normal, shared)

    return term


def solve_poses(
    points: TrackedPoints, data: DataTerm, prior: MotionPrior, start: Pose, iterations: int
) -> tuple[Pose, float]:
    """The poses that minimise data and prior cost, from `start`, and that cost."""
    pose, damping = start, START_DAMPING
    quadratic = data(point_positions(points, pose))
    cost = quadratic.cost + prior_cost(prior, points, pose)
    for _ in range(iterations):
        system = normal_equations(points, quadratic, prior, pose)
        while damping <= MOST_DAMPING:
            candidate = moved(points, pose, solve_equations(system, damping))
            # Where the step is taken, the next equations are set up from the same.
            at_candidate = data(point_positions(points, candidate))
            new_cost = at_candidate.cost + prior_cost(prior, points, candidate)
            if new_cost < cost:
                break
            damping *= 4
        else:
            return pose, cost
        decrease, pose, cost, quadratic = cost - new_cost, candidate, new_cost, at_candidate
        damping = max(damping / 5, LEAST_DAMPING)
        if decrease < CONVERGED * cost:
            break
    return pose, cost


def align_rigidly(
    source: Float64[np.ndarray, "points 3"],
    target: Float64[np.ndarray, "points 3"],
    weight: Float64[np.ndarray, " points"],
) -> tuple[Float64[np.ndarray, " 4"], Float64[np.ndarray, " 3"]]:
    """Rotation (wxyz) and translation to `target` by weighted least squares (Kabsch)."""
    w = weight / weight.sum()
    source_mean, target_mean = w @ source, w @ target
    covariance = (target - target_mean).T @ (w[:, None] * (source - source_mean))
    u, _, vt = np.linalg.svd(covariance)
    rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return quaternion_from_matrix(rotation), target_mean - rotation @ source_mean
