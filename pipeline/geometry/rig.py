"""Calibrating a rig: one bundle adjustment over all intrinsics, camera poses and board poses.

The model is Zhang's (2000): a planar target of known size seen in unknown poses. Here all cameras share the poses,
so that the views of one camera help all others. Distortion terms and the principal point have wide Gaussian priors:
a term that the views do not determine stays where a lens without faults has it, instead of running away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse
from jaxtyping import Float64, Int64

from pipeline.geometry.cameras import Camera
from pipeline.geometry.least_squares import solve_least_squares
from pipeline.geometry.projection import INTRINSICS, project_with_jacobian
from pipeline.geometry.rotations import left_jacobian, matrix_from_rotation_vector, skew

PRIOR_SIGMA = {"aspect": 0.01, "cx": 0.03, "cy": 0.03, "k1": 0.5, "k2": 0.5, "p1": 0.01, "p2": 0.01, "k3": 0.5}
"""About the spread of ordinary lenses from 10 to 90 degrees; cx and cy in units of the longer side. None for f."""

DISTORTION_TERMS = {0: (), 1: ("k1",), 2: ("k1", "k2"), 5: ("k1", "k2", "p1", "p2", "k3")}
"""Terms estimated under each number of coefficients; the others are exactly zero."""

LEAST_SIGMA_PX = 1e-3
"""Corners are never better than this: a fiftieth of the best that a detector does."""

POSE = 6
"""Numbers per pose: a rotation vector applied after the starting rotation, and the translation."""


@dataclass(frozen=True)
class Observations:
    """Board corners seen by cameras; one row per camera, view and corner. Pixels: first centre at (0.5, 0.5)."""

    camera: Int64[np.ndarray, " observations"]
    view: Int64[np.ndarray, " observations"]
    corner: Int64[np.ndarray, " observations"]
    pixel: Float64[np.ndarray, "observations 2"]

    def select(self, chosen: np.ndarray) -> Observations:
        """The rows that a mask or an index array names."""
        return Observations(self.camera[chosen], self.view[chosen], self.corner[chosen], self.pixel[chosen])


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
    """

    cameras: list[Camera]
    rig_from_board: Float64[np.ndarray, "views 4 4"]
    residual: Float64[np.ndarray, "observations 2"]
    weight: Float64[np.ndarray, " observations"]
    sigma_px: float
    focal_sigma: Float64[np.ndarray, " cameras"]
    center_sigma_m: Float64[np.ndarray, " cameras"]


def adjust_rig(
    observations: Observations,
    corners_m: Float64[np.ndarray, "corners 3"],
    cameras: Sequence[Camera],
    rig_from_board: Float64[np.ndarray, "views 4 4"],
    distortion: int,
) -> Rig:
    """Refine `cameras` and `rig_from_board` together; view 0 is the frame and does not move."""
    points = corners_m[observations.corner]
    start_R, start_board_R = np.stack([c.R for c in cameras]), rig_from_board[:, :3, :3]
    start = _pack(cameras, rig_from_board, distortion)
    mean, sigma = _priors(cameras, len(start))
    free = _free(len(cameras), len(rig_from_board), distortion)
    columns = np.flatnonzero(free)

    def evaluate(x: np.ndarray) -> tuple[np.ndarray, scipy.sparse.csc_array]:
        full = start.copy()
        full[columns] = x
        return _residuals(full, observations, points, start_R, start_board_R, columns)

    solution = solve_least_squares(evaluate, start[columns], LEAST_SIGMA_PX, mean[columns], sigma[columns])
    full = start.copy()
    full[columns] = solution.parameters
    covariance = np.zeros((len(start), len(start)))
    covariance[np.ix_(columns, columns)] = solution.covariance
    intrinsics, camera_pose, board_pose = _unpack(full, len(cameras))
    R, count = _rotations(camera_pose, start_R), len(cameras)
    solved = [_camera(intrinsics[c], R[c], camera_pose[c, 3:], cameras[c]) for c in range(count)]
    boards = np.tile(np.eye(4), (len(board_pose), 1, 1))
    boards[:, :3, :3], boards[:, :3, 3] = _rotations(board_pose, start_board_R), board_pose[:, 3:]
    focal_sigma = np.sqrt(np.diag(covariance)[: intrinsics.size : len(INTRINSICS)]) / intrinsics[:, 0]
    center_sigma = np.array([_center_sigma(covariance, c, count, camera_pose[c], solved[c]) for c in range(count)])
    return Rig(solved, boards, solution.residual, solution.weight, solution.sigma, focal_sigma, center_sigma)


def _camera(intrinsics: np.ndarray, R: np.ndarray, t: np.ndarray, start: Camera) -> Camera:
    f, aspect, cx, cy, *dist = intrinsics
    return replace(start, R=R, t=t, K=np.array([[f, 0, cx], [0, f * aspect, cy], [0, 0, 1]]), dist=np.array(dist))


def _center_sigma(covariance: np.ndarray, c: int, count: int, pose: np.ndarray, camera: Camera) -> float:
    """Centre = -R^T t; with R = exp(w) R0, d centre = -R^T (dt + [t]x J(w) dw)."""
    at = count * len(INTRINSICS) + c * POSE
    jacobian = -camera.R.T @ np.concatenate([skew(pose[3:]) @ left_jacobian(pose[:3]), np.eye(3)], 1)
    return float(np.sqrt(np.trace(jacobian @ covariance[at : at + POSE, at : at + POSE] @ jacobian.T) / 3))


def _pack(cameras: Sequence[Camera], rig_from_board: np.ndarray, distortion: int) -> np.ndarray:
    """Intrinsics of all cameras, their poses, the boards' poses; rotations as increments, so zero."""
    estimated = np.array([name in DISTORTION_TERMS[distortion] for name in INTRINSICS[4:]])
    intrinsics = [[c.K[0, 0], c.K[1, 1] / c.K[0, 0], c.K[0, 2], c.K[1, 2], *(c.dist * estimated)] for c in cameras]
    camera_pose = [[0, 0, 0, *c.t] for c in cameras]
    board_pose = [[0, 0, 0, *pose[:3, 3]] for pose in rig_from_board]
    return np.concatenate([np.ravel(part) for part in (intrinsics, camera_pose, board_pose)]).astype(np.float64)


def _unpack(x: np.ndarray, cameras: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    split = np.split(x, [cameras * len(INTRINSICS), cameras * (len(INTRINSICS) + POSE)])
    return split[0].reshape(cameras, -1), split[1].reshape(-1, POSE), split[2].reshape(-1, POSE)


def _priors(cameras: Sequence[Camera], count: int) -> tuple[np.ndarray, np.ndarray]:
    mean, sigma = np.zeros(count), np.full(count, np.inf)
    for c, camera in enumerate(cameras):
        longer = max(camera.width, camera.height)
        scale = {"cx": longer, "cy": longer}
        at = slice(c * len(INTRINSICS), (c + 1) * len(INTRINSICS))
        sigma[at] = [PRIOR_SIGMA.get(name, np.inf) * scale.get(name, 1) for name in INTRINSICS]
        mean[at] = [camera.K[0, 0], 1, camera.width / 2, camera.height / 2, 0, 0, 0, 0, 0]
    return mean, sigma


def _free(cameras: int, boards: int, distortion: int) -> np.ndarray:
    estimated = ("f", "aspect", "cx", "cy", *DISTORTION_TERMS[distortion])
    intrinsics = np.tile([name in estimated for name in INTRINSICS], cameras)
    return np.concatenate([intrinsics, np.ones(cameras * POSE, bool), np.arange(boards * POSE) >= POSE])


def _rotations(pose: np.ndarray, start: np.ndarray) -> np.ndarray:
    return matrix_from_rotation_vector(np.ascontiguousarray(pose[:, :3])) @ start


def _residuals(
    x: np.ndarray, observations: Observations, points: np.ndarray, start_R: np.ndarray, start_board_R: np.ndarray,
    columns: np.ndarray,
) -> tuple[np.ndarray, scipy.sparse.csc_array]:  # fmt: skip
    """Projected minus observed corners [n, 2] and the sparse Jacobian [2 n, len(columns)]."""
    c, v = observations.camera, observations.view
    intrinsics, camera_pose, board_pose = _unpack(x, len(start_R))
    R, board_R = _rotations(camera_pose, start_R)[c], _rotations(board_pose, start_board_R)[v]
    turned = np.einsum("nij,nj->ni", board_R, points)
    in_rig = turned + board_pose[v, 3:]
    rotated = np.einsum("nij,nj->ni", R, in_rig)
    pixel, by_intrinsics, by_point = project_with_jacobian(intrinsics[c], rotated + camera_pose[c, 3:])
    by_camera_turn = -by_point @ skew(rotated) @ left_jacobian(np.ascontiguousarray(camera_pose[:, :3]))[c]
    by_rig = by_point @ R
    by_board_turn = -by_rig @ skew(turned) @ left_jacobian(np.ascontiguousarray(board_pose[:, :3]))[v]
    blocks = np.concatenate([by_intrinsics, by_camera_turn, by_point, by_board_turn, by_rig], -1)
    poses, boards = intrinsics.size, intrinsics.size + camera_pose.size
    column = np.concatenate([
        c[:, None] * len(INTRINSICS) + np.arange(len(INTRINSICS)),
        poses + c[:, None] * POSE + np.arange(POSE),
        boards + v[:, None] * POSE + np.arange(POSE),
    ], 1)  # fmt: skip
    rows = np.broadcast_to(np.arange(2 * len(c)).reshape(-1, 2, 1), blocks.shape)
    column = np.broadcast_to(column[:, None], blocks.shape)
    matrix = scipy.sparse.csc_array((blocks.ravel(), (rows.ravel(), column.ravel())), shape=(2 * len(c), len(x)))
    return pixel - observations.pixel, matrix[:, columns]
