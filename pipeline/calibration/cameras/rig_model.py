"""What a bundle adjustment of a rig varies and what it compares: residuals, their Jacobian, priors.

The model is Zhang's (2000): a planar target of known size seen in unknown poses. Here all cameras share the poses,
so that the views of one camera help all others. Distortion terms and the principal point have wide Gaussian priors:
a term that the views do not determine stays where a lens without faults has it, instead of running away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse
from jaxtyping import Float64, Int64

from pipeline.calibration.cameras.projection import INTRINSICS, project_with_jacobian
from pipeline.geometry.cameras import Camera
from pipeline.geometry.rotations import left_jacobian, matrix_from_rotation_vector, skew

PRIOR_SIGMA = {"aspect": 0.01, "cx": 0.03, "cy": 0.03, "k1": 0.5, "k2": 0.5, "p1": 0.01, "p2": 0.01, "k3": 0.5}
"""About the spread of ordinary lenses from 10 to 90 degrees; cx and cy in units of the longer side. None for f."""

DISTORTION_TERMS = {0: (), 1: ("k1",), 2: ("k1", "k2"), 5: ("k1", "k2", "p1", "p2", "k3")}
"""Terms estimated under each number of coefficients; the others are exactly zero."""

POSE = 6
"""Numbers per pose: a rotation vector applied after the starting rotation, and the translation."""


@dataclass(frozen=True)
class Observations:
    """Board corners seen by cameras; one row per camera, view and corner. Pixels: first centre at (0.5, 0.5).

    A `view` is one pose of one board: two boards in one shot are two views. `corner` counts through all boards.
    """

    camera: Int64[np.ndarray, " observations"]
    view: Int64[np.ndarray, " observations"]
    corner: Int64[np.ndarray, " observations"]
    pixel: Float64[np.ndarray, "observations 2"]

    def select(self, chosen: np.ndarray) -> Observations:
        """The rows that a mask or an index array names."""
        return Observations(self.camera[chosen], self.view[chosen], self.corner[chosen], self.pixel[chosen])


@dataclass(frozen=True)
class RigModel:
    """One vector of parameters: intrinsics of all cameras, their poses, the boards' poses; those not `free` stay.

    Attributes:
        points: of each observation on its board, metres.
        cameras, rig_from_board: where the parameters start; rotations are increments to these.
        distortion: number of coefficients of each lens.
        lens: of each camera, its number: a camera that stood in two places is two cameras with one lens.
    """

    observations: Observations
    points: Float64[np.ndarray, "observations 3"]
    cameras: Sequence[Camera]
    rig_from_board: Float64[np.ndarray, "views 4 4"]
    distortion: Sequence[int]
    lens: Int64[np.ndarray, " cameras"]

    @cached_property
    def lenses(self) -> list[Camera]:
        """Of each lens, the first camera that has it."""
        return [self.cameras[c] for c in np.unique(self.lens, return_index=True)[1]]

    @cached_property
    def free(self) -> np.ndarray:
        """Numbers of the parameters that are estimated: the first view is the frame, some coefficients are zero."""
        fixed = ("f", "aspect", "cx", "cy")
        terms = [(*fixed, *DISTORTION_TERMS[number]) for number in self.distortion]
        intrinsics = np.ravel([[name in names for name in INTRINSICS] for names in terms])
        boards = np.arange(len(self.rig_from_board) * POSE) >= POSE
        return np.flatnonzero(np.concatenate([intrinsics, np.ones(len(self.cameras) * POSE, bool), boards]))

    def start(self) -> np.ndarray:
        """All parameters where they start; rotations as increments, so zero."""
        estimated = [[name in DISTORTION_TERMS[number] for name in INTRINSICS[4:]] for number in self.distortion]
        intrinsics = [
            [c.K[0, 0], c.K[1, 1] / c.K[0, 0], c.K[0, 2], c.K[1, 2], *(c.dist * used)]
            for c, used in zip(self.lenses, estimated, strict=True)
        ]
        camera_pose = [[0, 0, 0, *c.t] for c in self.cameras]
        board_pose = [[0, 0, 0, *pose[:3, 3]] for pose in self.rig_from_board]
        return np.concatenate([np.ravel(part) for part in (intrinsics, camera_pose, board_pose)]).astype(np.float64)

    def priors(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation of each parameter's prior, infinite where there is none."""
        count = self.start().size
        mean, sigma = np.zeros(count), np.full(count, np.inf)
        for c, camera in enumerate(self.lenses):
            at = slice(c * len(INTRINSICS), (c + 1) * len(INTRINSICS))
            sigma[at] = intrinsics_prior_sigma(camera)
            mean[at] = [camera.K[0, 0], 1, camera.width / 2, camera.height / 2, 0, 0, 0, 0, 0]
        return mean, sigma

    def split(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Intrinsics [lenses, 9], poses of the cameras and of the boards [:, 6]."""
        intrinsics = len(self.lenses) * len(INTRINSICS)
        parts = np.split(x, [intrinsics, intrinsics + len(self.cameras) * POSE])
        return parts[0].reshape(-1, len(INTRINSICS)), parts[1].reshape(-1, POSE), parts[2].reshape(-1, POSE)

    def pose_columns(self, camera: int) -> np.ndarray:
        """Where a camera's pose stands among all parameters."""
        return len(self.lenses) * len(INTRINSICS) + camera * POSE + np.arange(POSE)

    def rig_at(self, x: np.ndarray) -> tuple[list[Camera], np.ndarray]:
        """The cameras, and the boards' poses [views, 4, 4], that the parameters mean."""
        intrinsics, camera_pose, board_pose = self.split(x)
        start_R = np.stack([camera.R for camera in self.cameras])
        cameras = []
        poses = zip(
            intrinsics[self.lens], _rotations(camera_pose, start_R), camera_pose[:, 3:], self.cameras, strict=True
        )
        for (f, aspect, cx, cy, *dist), R, t, start in poses:
            K = np.array([[f, 0, cx], [0, f * aspect, cy], [0, 0, 1]])
            cameras.append(replace(start, R=R, t=t, K=K, dist=np.array(dist)))
        boards = np.tile(np.eye(4), (len(board_pose), 1, 1))
        boards[:, :3, :3] = _rotations(board_pose, self.rig_from_board[:, :3, :3])
        boards[:, :3, 3] = board_pose[:, 3:]
        return cameras, boards

    def center_jacobian(self, x: np.ndarray) -> np.ndarray:
        """Derivative of all centres [3 cameras, parameters]. Centre = -R^T t; with R = exp(w) R0,
        d centre = -R^T (dt + [t]x J(w) dw)."""
        _, pose, _ = self.split(x)
        jacobian = np.zeros((3 * len(self.cameras), len(x)))
        for c, camera in enumerate(self.rig_at(x)[0]):
            by_turn = skew(pose[c, 3:]) @ left_jacobian(pose[c, :3])
            by_pose = -camera.R.T @ np.concatenate([by_turn, np.eye(3)], 1)
            jacobian[3 * c : 3 * c + 3, self.pose_columns(c)] = by_pose
        return jacobian

    def residuals(self, x: np.ndarray) -> tuple[np.ndarray, scipy.sparse.csc_array]:
        """Projected minus observed corners [n, 2], and the sparse Jacobian [2 n, free parameters]."""
        c, v = self.observations.camera, self.observations.view
        start_R = np.stack([camera.R for camera in self.cameras])
        intrinsics, camera_pose, board_pose = self.split(x)
        lens = self.lens[c]
        R = _rotations(camera_pose, start_R)[c]
        turned = np.einsum("nij,nj->ni", _rotations(board_pose, self.rig_from_board[:, :3, :3])[v], self.points)
        in_rig = turned + board_pose[v, 3:]
        rotated = np.einsum("nij,nj->ni", R, in_rig)
        pixel, by_intrinsics, by_point = project_with_jacobian(intrinsics[lens], rotated + camera_pose[c, 3:])
        by_camera_turn = -by_point @ skew(rotated) @ left_jacobian(np.ascontiguousarray(camera_pose[:, :3]))[c]
        by_rig = by_point @ R
        by_board_turn = -by_rig @ skew(turned) @ left_jacobian(np.ascontiguousarray(board_pose[:, :3]))[v]
        blocks = np.concatenate([by_intrinsics, by_camera_turn, by_point, by_board_turn, by_rig], -1)
        boards = intrinsics.size + camera_pose.size
        column = np.concatenate([
            lens[:, None] * len(INTRINSICS) + np.arange(len(INTRINSICS)),
            intrinsics.size + c[:, None] * POSE + np.arange(POSE),
            boards + v[:, None] * POSE + np.arange(POSE),
        ], 1)  # fmt: skip
        rows = np.broadcast_to(np.arange(2 * len(c)).reshape(-1, 2, 1), blocks.shape)
        column = np.broadcast_to(column[:, None], blocks.shape)
        matrix = scipy.sparse.csc_array((blocks.ravel(), (rows.ravel(), column.ravel())), shape=(2 * len(c), len(x)))
        return pixel - self.observations.pixel, matrix[:, self.free]


def intrinsics_prior_sigma(camera: Camera) -> Float64[np.ndarray, " 9"]:
    """Standard deviations of the priors of `INTRINSICS`, infinite for f."""
    longer = max(camera.width, camera.height)
    scale = {"cx": longer, "cy": longer}
    return np.array([PRIOR_SIGMA.get(name, np.inf) * scale.get(name, 1) for name in INTRINSICS])


def _rotations(pose: np.ndarray, start: np.ndarray) -> np.ndarray:
    return matrix_from_rotation_vector(np.ascontiguousarray(pose[:, :3])) @ start
