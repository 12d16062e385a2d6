"""Normal equations of the poses of all frames, and their solution.

What data terms say of points is carried to the unknowns by the points' derivatives.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.linalg import LinAlgError, solve, solveh_banded
from scipy.linalg.blas import dsyrk

from pipeline.geometry.kinematics import Pose, TrackedPoints, derivatives_of
from pipeline.geometry.kinematics_kernels import carry_quadratic, carry_shared
from pipeline.tracking.motion_prior import BandedSystem, MotionPrior, prior_system


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
    """Normal equations of all frames together: their matrix's lower triangle, and the gradient.

    Above the diagonal, the matrix has anything.
    """

    lower: Float64[np.ndarray, "all all"]
    gradient: Float64[np.ndarray, "frames unknowns"]


def normal_equations(
    points: TrackedPoints, quadratic: PointQuadratic, prior: MotionPrior, pose: Pose
) -> BandedSystem | DenseSystem:
    """The equations of data and prior around a pose. Points on which no data bear cost nothing."""
    system, unknowns = prior_system(prior, points, pose), points.unknowns
    diagonal, gradient = system.diagonal.copy(), system.gradient.copy()
    coupled = quadratic.shared is not None and quadratic.shared.any()
    if coupled:
        some, own = (quadratic.shared != 0).any((0, 2, 3)), quadratic.shared.shape[3]
        rows = np.where(some, own * (np.cumsum(some) - 1), -1)
        factor = np.zeros((len(pose), own * np.count_nonzero(some), unknowns))
    # A Gauss-Newton matrix is zero where its diagonal is.
    borne = (np.einsum("fpaa->fp", quadratic.normal) != 0) | quadratic.gradient.any(2)
    by_frame = derivatives_of(points, pose, borne)
    for frame, (which, derivatives) in enumerate(by_frame):
        carried = np.empty_like(derivatives)
        carry_quadratic(which, derivatives, quadratic.normal[frame], carried)
        flat = derivatives.reshape(-1, unknowns)
        diagonal[frame] += flat.T @ carried.reshape(-1, unknowns)
        gradient[frame] += quadratic.gradient[frame, which].ravel() @ flat
        if coupled:
            carry_shared(which, derivatives, quadratic.shared[frame], rows, factor[frame])
    banded = BandedSystem(diagonal, system.first, system.second, gradient)
    return _coupled(banded, factor.transpose(1, 0, 2).reshape(factor.shape[1], -1)) if coupled else banded


def _coupled(system: BandedSystem, factor: Float64[np.ndarray, "own all"]) -> DenseSystem:
    """The banded system less factor^T @ factor, as one matrix."""
    frames, unknowns = system.gradient.shape
    matrix = np.zeros((frames, unknowns, frames, unknowns))
    for apart, blocks in enumerate((system.diagonal, system.first, system.second)):
        for frame in range(frames - apart):
            matrix[frame + apart, :, frame] = blocks[frame]
    # BLAS reads arrays column by column: to it, all are transposed, and the lower triangle is the upper one.
    whole = matrix.reshape(frames * unknowns, -1)
    lower = dsyrk(-1.0, factor.T, beta=1.0, c=whole.T, lower=0, overwrite_c=1).T
    return DenseSystem(lower, system.gradient)


def solve_equations(system: BandedSystem | DenseSystem, damping: float) -> Float64[np.ndarray, "frames unknowns"]:
    """-(H + damping diag H)^-1 g by Cholesky, banded where only neighbouring frames are coupled."""
    if isinstance(system, DenseSystem):
        return _solve_dense(system, damping)
    frames, unknowns = system.gradient.shape
    # Of each frame, what stands below it in the frame's columns: its own block, those of the next two, and zeros.
    below = np.zeros((frames, 4 * unknowns, unknowns))
    below[:, : 3 * unknowns] = np.concatenate([system.diagonal, system.first, system.second], 1)
    # banded[k, f, c] = below[f, c + k, c]
    block, row, number = below.strides
    strided = np.lib.stride_tricks.as_strided(
        below, (3 * unknowns, frames, unknowns), (row, block, row + number), writeable=False
    )
    # A copy: of a lone frame, reshaping alone would make none.
    banded = strided.copy().reshape(3 * unknowns, -1)
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
