"""Parameters and residuals of a rig's bundle adjustment, with Jacobian and priors.

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

from pipeline.calibration.cameras.intrinsics_priors import given_prior_sigma, intrinsics_prior_sigma
from pipeline.calibration.cameras.rig_inputs import NOTHING_KNOWN, Observations, RigPriors
from pipeline.geometry.cameras import PINHOLE_TERMS, Camera, project_with_jacobian
from pipeline.geometry.lens import Lens
from pipeline.geometry.rotations import left_jacobian, matrix_from_rotation_vector, skew

LAG_SIGMA_S = 0.1
"""Standard deviation of the prior of a camera's lag behind the others: three images of an ordinary camera wait for the
computer. All lags together are open, as they move all boards alike."""

POSE = 6
"""Numbers per pose: a rotation vector applied after the starting rotation, and the translation."""


@dataclass(frozen=True)
class RigModel:
    """Parameters of a rig in one vector.

    Intrinsics of all lenses, poses of the cameras, poses of the boards; those not `free` stay.

    Attributes:
        points: of each observation on its board, metres.
        cameras, rig_from_board: where the parameters start; rotations are increments to these.
        distortion: number of leading coefficients of each physical lens that are estimated; the others are zero.
        lens_index: of each camera, its physical lens: a camera that stood in two places is two cameras with one lens.
        known: what is known beforehand.
    """

    observations: Observations
    points: Float64[np.ndarray, "observations 3"]
    cameras: Sequence[Camera]
    rig_from_board: Float64[np.ndarray, "views 4 4"]
    distortion: Sequence[int]
    lens_index: Int64[np.ndarray, " cameras"]
    known: RigPriors = NOTHING_KNOWN

    @cached_property
    def clocked(self) -> tuple[Int64[np.ndarray, "images 2"], Int64[np.ndarray, " observations"]]:
        """Images (camera, view) whose time is estimated, and of each observation its image.

        -1 for none. Those of views that one camera sees alone stay: their time only moves the board.
        """
        seen = self.observations
        if seen.motion is None:
            return np.zeros((0, 2), np.int64), np.full(len(seen.camera), -1)
        images, number = np.unique(np.stack([seen.camera, seen.view], 1), axis=0, return_inverse=True)
        shared = np.bincount(images[:, 1])[images[:, 1]] > 1
        return images[shared], np.where(shared, np.cumsum(shared) - 1, -1)[number.ravel()]

    @cached_property
    def lens(self) -> Lens:
        """The one model of all lenses.

        Raises:
            ValueError: if cameras have different ones.
        """
        models = list(dict.fromkeys(camera.lens for camera in self.cameras))
        if len(models) != 1:
            raise ValueError(f"cameras: expected one lens model, found {', '.join(lens.name for lens in models)}")
        return models[0]

    @cached_property
    def intrinsics_count(self) -> int:
        """Intrinsics per lens: `PINHOLE_TERMS` and the lens's terms."""
        return len(PINHOLE_TERMS) + len(self.lens.terms)

    @cached_property
    def lens_cameras(self) -> list[Camera]:
        """The first camera of each physical lens."""
        return [self.cameras[c] for c in np.unique(self.lens_index, return_index=True)[1]]

    def _estimated(self) -> np.ndarray:
        """Mask of the estimated terms [lenses, terms]."""
        return np.arange(len(self.lens.terms)) < np.array(self.distortion)[:, None]

    @cached_property
    def free(self) -> np.ndarray:
        """Numbers of the parameters that are estimated.

        The first view is the frame, some coefficients are zero.
        """
        estimated = self._estimated()
        intrinsics = np.concatenate([np.ones((len(estimated), len(PINHOLE_TERMS)), bool), estimated], 1).ravel()
        if self.known.fixed:
            intrinsics[:] = False
        boards = np.arange(len(self.rig_from_board) * POSE) >= POSE
        times = np.ones(self.start().size - len(intrinsics) - len(self.cameras) * POSE - len(boards), bool)
        return np.flatnonzero(np.concatenate([intrinsics, np.ones(len(self.cameras) * POSE, bool), boards, times]))

    def start(self) -> np.ndarray:
        """Start of all parameters; rotations as increments, so zero."""
        known = np.concatenate([np.ones((len(self.distortion), len(PINHOLE_TERMS))), self._estimated()], 1)
        intrinsics = np.stack([camera.intrinsics() for camera in self.lens_cameras]) * known
        camera_pose = [[0, 0, 0, *c.t] for c in self.cameras]
        board_pose = [[0, 0, 0, *pose[:3, 3]] for pose in self.rig_from_board]
        lags = np.zeros(len(self.cameras) if len(self.clocked[0]) else 0)
        parts = (intrinsics, camera_pose, board_pose, self._measured_times(), lags)
        return np.concatenate([np.ravel(part) for part in parts]).astype(np.float64)

    def _measured_times(self) -> np.ndarray:
        """Of each image of `clocked`, its time in the table."""
        images, number = self.clocked
        times = np.zeros(len(images))
        if self.observations.motion is not None:
            times[number[number >= 0]] = self.observations.motion.time_s[number >= 0]
        return times

    def priors(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation of each parameter's prior, infinite where there is none."""
        count = self.start().size
        mean, sigma = np.zeros(count), np.full(count, np.inf)
        for c, camera in enumerate(self.lens_cameras):
            at = self.intrinsics_columns(c)
            sigma[at] = intrinsics_prior_sigma(camera)
            flawless = self.lens.no_distortion()
            mean[at] = [camera.K[0, 0], 1, camera.width / 2, camera.height / 2, *flawless]
            if self.known.lenses is not None and not self.known.fixed:
                given = self.known.lenses[np.flatnonzero(self.lens_index == c)[0]]
                mean[at], sigma[at] = given.intrinsics(), given_prior_sigma(given, self.known.lens_sigma)
        if len(self.clocked[0]):
            mean[self.times_columns], sigma[self.times_columns] = self._measured_times(), self.known.clock_sigma_s
            sigma[self.lag_columns] = LAG_SIGMA_S
        return mean, sigma

    @property
    def times_columns(self) -> slice:
        """Place of the times of the images of `clocked` among all parameters."""
        first = len(self.lens_cameras) * self.intrinsics_count + (len(self.cameras) + len(self.rig_from_board)) * POSE
        return slice(first, first + len(self.clocked[0]))

    @property
    def lag_columns(self) -> slice:
        """Place of the cameras' lags among all parameters: the last.

        All times of a camera are late by its lag.
        """
        return slice(self.times_columns.stop, None)

    def split(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Intrinsics [lenses, intrinsics], poses of the cameras and of the boards [:, 6]."""
        intrinsics = len(self.lens_cameras) * self.intrinsics_count
        parts = np.split(x[: self.times_columns.start], [intrinsics, intrinsics + len(self.cameras) * POSE])
        return parts[0].reshape(-1, self.intrinsics_count), parts[1].reshape(-1, POSE), parts[2].reshape(-1, POSE)

    def intrinsics_columns(self, lens: int) -> slice:
        """Place of a physical lens's intrinsics among all parameters."""
        return slice(lens * self.intrinsics_count, (lens + 1) * self.intrinsics_count)

    def pose_columns(self, camera: int) -> np.ndarray:
        """Place of a camera's pose among all parameters."""
        return len(self.lens_cameras) * self.intrinsics_count + camera * POSE + np.arange(POSE)

    def rig_at(self, x: np.ndarray) -> tuple[list[Camera], np.ndarray]:
        """The cameras, and the boards' poses [views, 4, 4], that the parameters mean."""
        intrinsics, camera_pose, board_pose = self.split(x)
        start_R = np.stack([camera.R for camera in self.cameras])
        cameras = []
        poses = zip(
            intrinsics[self.lens_index], _rotations(camera_pose, start_R), camera_pose[:, 3:], self.cameras, strict=True
        )
        for (f, aspect, cx, cy, *dist), R, t, start in poses:
            K = np.array([[f, 0, cx], [0, f * aspect, cy], [0, 0, 1]])
            cameras.append(replace(start, R=R, t=t, K=K, dist=np.array(dist)))
        boards = np.tile(np.eye(4), (len(board_pose), 1, 1))
        boards[:, :3, :3] = _rotations(board_pose, self.rig_from_board[:, :3, :3])
        boards[:, :3, 3] = board_pose[:, 3:]
        return cameras, boards

    def pose_jacobian(self, x: np.ndarray) -> np.ndarray:
        """Derivative of all turns and centres [6 cameras, parameters], three rows of each.

        A turn is about the camera's own axes; with R = exp(w) R0 it is J(w) dw, and the centre, -R^T t, moves by
        -R^T (dt + [t]x J(w) dw).
        """
        _, pose, _ = self.split(x)
        jacobian = np.zeros((POSE * len(self.cameras), len(x)))
        for c, camera in enumerate(self.rig_at(x)[0]):
            turn = left_jacobian(pose[c, :3])
            center = -camera.R.T @ np.concatenate([skew(pose[c, 3:]) @ turn, np.eye(3)], 1)
            by_pose = np.concatenate([np.concatenate([turn, np.zeros((3, 3))], 1), center])
            jacobian[POSE * c : POSE * (c + 1), self.pose_columns(c)] = by_pose
        return jacobian

    @cached_property
    def _pattern(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Which entries of the blocks of `residuals` belong to free parameters [2 n, entries], and CSR's two indices.

        An entry's column ascends within a row: intrinsics, camera, board, time, lag.
        """
        c, v = self.observations.camera, self.observations.view
        cameras = len(self.lens_cameras) * self.intrinsics_count
        boards = cameras + len(self.cameras) * POSE
        column = [
            self.lens_index[c][:, None] * self.intrinsics_count + np.arange(self.intrinsics_count),
            cameras + c[:, None] * POSE + np.arange(POSE),
            boards + v[:, None] * POSE + np.arange(POSE),
        ]
        place = np.full(self.start().size + 1, -1)
        place[self.free] = np.arange(len(self.free))
        if len(self.clocked[0]):
            image, nowhere = self.clocked[1], len(place) - 1
            times = [self.times_columns.start + image, self.lag_columns.start + c]
            column.append(np.where(image >= 0, times, nowhere).T)
        at = np.repeat(place[np.concatenate(column, 1)], 2, axis=0)
        kept = at >= 0
        return kept, at[kept], np.concatenate([[0], np.cumsum(kept.sum(1))])

    def residuals(self, x: np.ndarray) -> tuple[np.ndarray, scipy.sparse.csr_array]:
        """Projected minus observed corners [n, 2], and the sparse Jacobian [2 n, free parameters]."""
        c, v = self.observations.camera, self.observations.view
        start_R = np.stack([camera.R for camera in self.cameras])
        intrinsics, camera_pose, board_pose = self.split(x)
        R = _rotations(camera_pose, start_R)[c]
        turned = np.einsum("nij,nj->ni", _rotations(board_pose, self.rig_from_board[:, :3, :3])[v], self.points)
        in_rig = turned + board_pose[v, 3:]
        rotated = np.einsum("nij,nj->ni", R, in_rig)
        pixel, by_intrinsics, by_point = project_with_jacobian(
            self.lens, intrinsics[self.lens_index[c]], rotated + camera_pose[c, 3:]
        )
        by_camera_turn = -by_point @ skew(rotated) @ left_jacobian(np.ascontiguousarray(camera_pose[:, :3]))[c]
        by_rig = by_point @ R
        by_board_turn = -by_rig @ skew(turned) @ left_jacobian(np.ascontiguousarray(board_pose[:, :3]))[v]
        blocks = [by_intrinsics, by_camera_turn, by_point, by_board_turn, by_rig]
        residual = pixel - self.observations.pixel
        if len(self.clocked[0]):
            moved, by_time = self._moved(x)
            residual = residual + moved
            blocks += [by_time[:, :, None]] * 2  # a camera's lag adds to the image's time
        kept, column, rows = self._pattern
        value = np.concatenate(blocks, -1).reshape(kept.shape)[kept]
        return residual, scipy.sparse.csr_array((value, column, rows), shape=(len(kept), len(self.free)))

    def _moved(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far each corner has moved since its view's mean time [n, 2], and its derivative by the image's time.

        To second order: a hand turns round in tenths of a second, and images of one view are as much as a tenth apart.
        """
        image, motion = self.clocked[1], self.observations.motion
        timed = (image >= 0)[:, None]
        late = np.where(timed, x[self.times_columns][image][:, None], 0)
        late = late + np.where(timed, x[self.lag_columns][self.observations.camera][:, None], 0)
        moved = (motion.velocity - motion.acceleration * late / 2) * late
        return np.where(timed, moved, 0), np.where(timed, motion.velocity - motion.acceleration * late, 0)


def _rotations(pose: np.ndarray, start: np.ndarray) -> np.ndarray:
    return matrix_from_rotation_vector(np.ascontiguousarray(pose[:, :3])) @ start
