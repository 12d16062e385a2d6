"""Poses of all frames of a chunk by one block-banded Levenberg-Marquardt problem.

The data terms see tracked points only: each returns, per point, the gradient and Gauss-Newton matrix by its world
position, which the kinematic chain then carries to the unknowns. So the cost hardly depends on the number of cameras.
The robust loss is Cauchy's, ``c^2/2 log(1 + (r / c)^2)``, by iterated reweighting.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.linalg import LinAlgError, solve, solveh_banded

from pipeline.geometry.cameras import Camera
from pipeline.geometry.kinematics import Pose, TrackedPoints, moved, point_positions, points_with_derivatives
from pipeline.geometry.least_squares import cauchy
from pipeline.geometry.rotations import quaternion_from_matrix
from pipeline.geometry.triangulation import reprojection
from pipeline.tracking.motion_prior import BandedSystem, MotionPrior, prior_cost, prior_system

START_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-9, 1e8
"""Of Levenberg-Marquardt, relative to the diagonal. Where even the most does not help, rounding has been reached."""

CONVERGED = 1e-7
"""Relative decrease of the cost that ends the iteration: a thousandth of a standard deviation at 10^4 residuals."""


@dataclass(frozen=True)
class PointQuadratic:
    """Cost, and per point its gradient and Gauss-Newton matrix by the world position.

    `shared` couples the frames: a point's matrix between frames f and g has -shared_f shared_g^T added. It is what is
    left of unknowns of the point's own, common to all frames, that were solved for and eliminated (Schur complement).
    """

    cost: float
    gradient: Float64[np.ndarray, "frames points 3"]
    normal: Float64[np.ndarray, "frames points 3 3"]
    shared: Float64[np.ndarray, "frames points 3 own"] | None = None


@dataclass(frozen=True)
class DenseSystem:
    """Normal equations of all frames together: their matrix's lower triangle, and the gradient."""

    lower: Float64[np.ndarray, "all all"]
    gradient: Float64[np.ndarray, "frames unknowns"]


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
    cost = data(point_positions(points, pose)).cost + prior_cost(prior, points, pose)
    for _ in range(iterations):
        system = _system(points, data, prior, pose)
        while damping <= MOST_DAMPING:
            candidate = moved(points, pose, _solve(system, damping))
            new_cost = data(point_positions(points, candidate)).cost + prior_cost(prior, points, candidate)
            if new_cost < cost:
                break
            damping *= 4
        else:
            return pose, cost
        decrease, pose, cost = cost - new_cost, candidate, new_cost
        damping = max(damping / 5, LEAST_DAMPING)
        if decrease < CONVERGED * cost:
            break
    return pose, cost


def _system(points: TrackedPoints, data: DataTerm, prior: MotionPrior, pose: Pose) -> BandedSystem | DenseSystem:
    positions, derivatives = points_with_derivatives(points, pose)
    quadratic, system = data(positions), prior_system(prior, points, pose)
    frames, unknowns = len(pose), points.unknowns
    flat = derivatives.reshape(frames, -1, unknowns)
    carried = (quadratic.normal @ derivatives).reshape(frames, -1, unknowns)
    gradient = (quadratic.gradient.reshape(frames, 1, -1) @ flat)[:, 0]
    banded = BandedSystem(
        system.diagonal + flat.swapaxes(1, 2) @ carried, system.first, system.second, system.gradient + gradient
    )
    if quadratic.shared is None:
        return banded
    # [frames, unknowns, points with anything shared, own]
    some = np.flatnonzero((quadratic.shared != 0).any((0, 2, 3)))
    factor = np.einsum("fpau,fpak->fupk", derivatives[:, some], quadratic.shared[:, some], optimize=True)
    return _coupled(banded, factor.reshape(frames * unknowns, -1))


def _coupled(system: BandedSystem, factor: Float64[np.ndarray, "all own"]) -> DenseSystem:
    """The banded system less factor @ factor^T, as one matrix."""
    frames, unknowns = system.gradient.shape
    matrix = np.zeros((frames, unknowns, frames, unknowns))
    for apart, blocks in enumerate((system.diagonal, system.first, system.second)):
        for frame in range(frames - apart):
            matrix[frame + apart, :, frame] = blocks[frame]
    lower = matrix.reshape(frames * unknowns, -1) - np.tril(factor @ factor.T)
    return DenseSystem(lower, system.gradient)


def _solve(system: BandedSystem | DenseSystem, damping: float) -> Float64[np.ndarray, "frames unknowns"]:
    """-(H + damping diag H)^-1 g by Cholesky, banded where only neighbouring frames are coupled."""
    if isinstance(system, DenseSystem):
        return _solve_dense(system, damping)
    frames, unknowns = system.gradient.shape
    banded = np.zeros((3 * unknowns, frames * unknowns))
    row, column = np.indices((unknowns, unknowns)).reshape(2, -1)
    for apart, blocks in enumerate((system.diagonal, system.first, system.second)):
        below = apart * unknowns + row - column
        kept = below >= 0
        for frame in range(frames - apart):
            banded[below[kept], frame * unknowns + column[kept]] = blocks[frame, row[kept], column[kept]]
    banded[0] *= 1 + damping
    # An unknown that nothing constrains (a lone frame's root, without data) stays where it is.
    banded[0] = np.where(banded[0] > 0, banded[0], 1.0)
    try:
        step = solveh_banded(banded, -system.gradient.ravel(), lower=True, check_finite=False)
    except LinAlgError:  # not positive definite to rounding: no step, so that the caller damps more
        return np.zeros((frames, unknowns))
    return step.reshape(frames, unknowns)


def _solve_dense(system: DenseSystem, damping: float) -> Float64[np.ndarray, "frames unknowns"]:
    matrix = system.lower.copy()
    diagonal = np.einsum("ii->i", matrix)
    diagonal *= 1 + damping
    diagonal[diagonal <= 0] = 1.0
    try:
        step = solve(matrix, -system.gradient.ravel(), lower=True, assume_a="pos", overwrite_a=True, check_finite=False)
    except LinAlgError:
        return np.zeros_like(system.gradient)
    return step.reshape(system.gradient.shape)


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
