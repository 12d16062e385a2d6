"""Bundle adjustment of a rig over all intrinsics, camera poses and board poses.

With its error bars.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse
from jaxtyping import Float64, Int64

from pipeline.calibration.cameras.rig_inputs import NOTHING_KNOWN, Observations, RigPriors
from pipeline.calibration.cameras.rig_model import POSE, RigModel
from pipeline.geometry.cameras import Camera
from pipeline.geometry.least_squares import CAUCHY, solve_least_squares
from pipeline.geometry.rotations import skew

LEAST_CLOCK_SIGMA_S = 1e-5
"""Times are never better than this: a hundredth of a pixel at 1000 pixels per second, the speed of a waved board."""

CLOCK_ROUNDS, CLOCK_SETTLED = 12, 0.05
"""Rounds at most until the standard deviation changes by less than this share: error bars need no more."""

LEAST_SIGMA_PX = 1e-3
"""Corners are never better than this: a fiftieth of the best that a detector does."""


@dataclass(frozen=True)
class Rig:
    """A calibrated rig in the frame of the first board view.

    Attributes:
        rig_from_board: per view, 4 x 4.
        residual: projected minus observed corner, pixels.
        weight: of each corner in the robust fit, 1 = fully counted.
        sigma_px: noise of one coordinate of a corner.
        focal_sigma: relative standard deviation of each camera's focal length.
        center_sigma_m: standard deviation of each camera's centre, root mean square over the axes.
        center_covariance: of all centres, after the rigid motion that fits them best to the true ones: the rig's
            shape, which is all that a board tells. Where the first view happens to lie does not count.
        pose_covariances: of each camera's turn and centre, as in `RigModel.pose_jacobian`, in the frame of the first
            view; of several, error bars are the largest.
        intrinsics_covariance: of each `Camera.intrinsics`; zero where a term is not estimated.
        clock_sigma_s: standard deviation of the images' times, estimated; 0 where those of a view are taken at once.
        model, parameters, normal_inverse: the problem, its minimum, and the inverse of its weighted normal matrix.
    """

    cameras: list[Camera]
    rig_from_board: Float64[np.ndarray, "views 4 4"]
    residual: Float64[np.ndarray, "observations 2"]
    weight: Float64[np.ndarray, " observations"]
    sigma_px: float
    focal_sigma: Float64[np.ndarray, " cameras"]
    center_sigma_m: Float64[np.ndarray, " cameras"]
    center_covariance: Float64[np.ndarray, "axes axes"]
    pose_covariances: tuple[Float64[np.ndarray, "poses poses"], ...]
    intrinsics_covariance: Float64[np.ndarray, "cameras intrinsics intrinsics"]
    clock_sigma_s: float
    model: RigModel
    parameters: Float64[np.ndarray, " parameters"]
    normal_inverse: Float64[np.ndarray, "free free"]


def adjust_rig(
    observations: Observations,
    corners_m: Float64[np.ndarray, "corners 3"],
    cameras: Sequence[Camera],
    rig_from_board: Float64[np.ndarray, "views 4 4"],
    distortion: int | Sequence[int],
    lens_index: Sequence[int] | None = None,
    known: RigPriors = NOTHING_KNOWN,
) -> Rig:
    """Refine `cameras` and `rig_from_board` together; view 0 is the frame and does not move.

    Args:
        distortion: number of coefficients, of all lenses or of each.
        lens_index: number of each camera's lens, counted from 0 without gaps; None: each camera has its own.
        known: what is known beforehand; lenses that are known and stay are those of `cameras`.
    """
    owned = np.arange(len(cameras)) if lens_index is None else np.asarray(lens_index, np.int64)
    numbers = [distortion] * len(np.unique(owned)) if isinstance(distortion, int) else list(distortion)
    model = RigModel(observations, corners_m[observations.corner], cameras, rig_from_board, numbers, owned, known)
    return _adjust(model)


def _adjust(model: RigModel) -> Rig:
    start, (mean, sigma), free = model.start(), model.priors(), model.free

    def evaluate(x: np.ndarray) -> tuple[np.ndarray, scipy.sparse.csr_array]:
        full = start.copy()
        full[free] = x
        return model.residuals(full)

    solution = solve_least_squares(evaluate, start[free], LEAST_SIGMA_PX, mean[free], sigma[free])
    full = start.copy()
    full[free] = solution.parameters
    solved, boards = model.rig_at(full)
    covariance = np.zeros((len(full), len(full)))
    precision = 1.0 / np.square(sigma[free])
    inflation = robust_inflation(solution.residual / solution.sigma, len(free))
    covariance[np.ix_(free, free)] = _rescaled(solution.covariance, precision, inflation)
    by_parameters = model.pose_jacobian(full)
    poses = by_parameters @ covariance @ by_parameters.T
    centers = center_covariance(poses, solved)
    intrinsics = np.stack([covariance[at, at] for at in map(model.intrinsics_columns, model.lens_index.tolist())])
    focal_sigma = np.sqrt(intrinsics[:, 0, 0]) / np.array([camera.K[0, 0] for camera in solved])
    center_sigma = np.sqrt(np.maximum(np.diag(centers), 0).reshape(-1, 3).mean(1))
    at = model.times_columns
    clock = _clock_sigma(full[at] - mean[at], covariance[at, at], model.clocked[0][:, 1], model.known.clock_sigma_s)
    return Rig(
        solved, boards, solution.residual, solution.weight, solution.sigma, focal_sigma, center_sigma, centers,
        (poses,), intrinsics, clock, model, full, solution.covariance,
    )  # fmt: skip


def settle_clock(rig: Rig) -> Rig:
    """The rig adjusted with as good a clock as its images show, if they have times.

    MacKay's fixed point (1992) for the standard deviation of the times.
    """
    model = rig.model
    for _ in range(CLOCK_ROUNDS):
        before = model.known.clock_sigma_s
        if not len(model.clocked[0]) or abs(rig.clock_sigma_s - before) < CLOCK_SETTLED * before:
            break
        known = replace(model.known, clock_sigma_s=rig.clock_sigma_s)
        model = replace(model, cameras=rig.cameras, rig_from_board=rig.rig_from_board, known=known)
        rig = _adjust(model)
    return rig


def robust_inflation(scaled: Float64[np.ndarray, "observations 2"], fitted: int) -> float:
    """Variance of the robust estimate over what the inverse of its weighted normal matrix says.

    The weighted normal matrix takes each corner for `weight` corners, but the estimate is not that of a weighted
    fit: its weights follow the residuals. Huber (1981, section 7.6): with the influence psi = w r, the covariance is
    E psi^2 / (E psi')^2 times (J^T J)^-1. For Gaussian noise the result is 0.83 (0.91 in sigma).

    Args:
        scaled: residuals over their noise.
        fitted: number of parameters, which shrink the residuals.
    """
    squared, weight = _squared_and_weight(scaled, fitted)
    influence = (weight**2 * squared).mean() / 2
    slope = robust_slope(scaled, fitted)
    # More than half of the corners gross errors: no slope is left, and nothing is known.
    return float(influence * weight.mean() / slope**2) if slope > 0 else float(len(scaled))


def robust_slope(scaled: Float64[np.ndarray, "observations 2"], fitted: int) -> float:
    """Mean derivative of the influence by a residual: E psi' of `robust_inflation`."""
    squared, weight = _squared_and_weight(scaled, fitted)
    return float((weight - weight**2 * squared / CAUCHY**2).mean())


def _squared_and_weight(scaled: np.ndarray, fitted: int) -> tuple[np.ndarray, np.ndarray]:
    squared = (scaled**2).sum(1) * scaled.size / max(scaled.size - fitted, 1)
    return squared, 1.0 / (1.0 + squared / CAUCHY**2)


def _clock_sigma(
    error_s: np.ndarray, covariance: np.ndarray, view: Int64[np.ndarray, " images"], prior_sigma_s: float
) -> float:
    """Root mean square of the times' errors, over as many as the images determine; 0 without times.

    All images of a view may be late together: then the board was elsewhere. So only differences within views count.
    """
    if len(error_s) == 0:
        return 0.0
    together = (view[:, None] == view) / np.bincount(view)[view]
    apart = np.eye(len(view)) - together
    left_open = np.diag(apart @ covariance @ apart) / prior_sigma_s**2
    determined = np.clip(np.diag(apart) - left_open, 0, 1).sum()
    return max(float(np.sqrt(((apart @ error_s) ** 2).sum() / max(determined, 1.0))), LEAST_CLOCK_SIGMA_S)


def _rescaled(inverse: np.ndarray, precision: np.ndarray, inflation: float) -> np.ndarray:
    """(N / inflation + P)^-1 from (N + P)^-1: the data's part is rescaled, the priors stay."""
    change = (inflation - 1) * inverse * precision
    return inflation * np.linalg.solve(np.eye(len(inverse)) + change, inverse)


def center_covariance(
    poses: Float64[np.ndarray, "poses poses"], cameras: Sequence[Camera]
) -> Float64[np.ndarray, "axes axes"]:
    """Covariance of the centres after a best rigid motion, of that of the poses."""
    rows, keep = center_rows(len(cameras)), shape_projection(cameras)
    return keep @ poses[np.ix_(rows, rows)] @ keep.T


def center_rows(cameras: int) -> Int64[np.ndarray, " axes"]:
    """Places of the centres in `RigModel.pose_jacobian`."""
    return np.arange(cameras * POSE).reshape(cameras, POSE)[:, POSE - 3 :].ravel()


def shape_projection(cameras: Sequence[Camera]) -> Float64[np.ndarray, "axes axes"]:
    """Projection of small motions of the centres onto those that change the rig's shape.

    The directions of rigid motions are projected out (Kanatani and Morris 2001). With up to two cameras little of a
    shape remains: none of one, the distance of two.
    """
    centers = np.stack([camera.center for camera in cameras])
    moved = [np.concatenate([np.eye(3), -skew(center)], 1) for center in centers - centers.mean(0)]
    motions = np.concatenate(moved)
    return np.eye(len(motions)) - motions @ np.linalg.pinv(motions, rcond=1e-9)
