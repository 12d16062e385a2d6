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

from pipeline.geometry.cameras import PINHOLE_TERMS, Camera, project_with_jacobian
from pipeline.geometry.lens import Lens
from pipeline.geometry.rotations import left_jacobian, matrix_from_rotation_vector, skew

PRIOR_SIGMA = {"f": np.inf, "aspect": 0.01, "cx": 0.03, "cy": 0.03}
"""Standard deviations of the priors of `PINHOLE_TERMS`: about the spread of ordinary cameras, cx and cy in units of the
longer side, none for f. Those of a lens's terms are its own."""

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
    """Parameters of a rig in one vector.

    Intrinsics of all lenses, poses of the cameras, poses of the boards; those not `free` stay.

    Attributes:
        points: of each observation on its board, metres.
        cameras, rig_from_board: where the parameters start; rotations are increments to these.
        distortion: number of leading coefficients of each physical lens that are estimated; the others are zero.
        lens_index: of each camera, its physical lens: a camera that stood in two places is two cameras with one lens.
    """

    observations: Observations
    points: Float64[np.ndarray, "observations 3"]
    cameras: Sequence[Camera]
    rig_from_board: Float64[np.ndarray, "views 4 4"]
    distortion: Sequence[int]
    lens_index: Int64[np.ndarray, " cameras"]

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
        boards = np.arange(len(self.rig_from_board) * POSE) >= POSE
        return np.flatnonzero(np.concatenate([intrinsics, np.ones(len(self.cameras) * POSE, bool), boards]))

    def start(self) -> np.ndarray:
        """Start of all parameters; rotations as increments, so zero."""
        known = np.concatenate([np.ones((len(self.distortion), len(PINHOLE_TERMS))), self._estimated()], 1)
        intrinsics = np.stack([camera.intrinsics() for camera in self.lens_cameras]) * known
        camera_pose = [[0, 0, 0, *c.t] for c in self.cameras]
        board_pose = [[0, 0, 0, *pose[:3, 3]] for pose in self.rig_from_board]
        return np.concatenate([np.ravel(part) for part in (intrinsics, camera_pose, board_pose)]).astype(np.float64)

    def priors(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation of each parameter's prior, infinite where there is none."""
        count = self.start().size
        mean, sigma = np.zeros(count), np.full(count, np.inf)
        for c, camera in enumerate(self.lens_cameras):
            at = self.intrinsics_columns(c)
            sigma[at] = intrinsics_prior_sigma(camera)
            flawless = self.lens.no_distortion()
            mean[at] = [camera.K[0, 0], 1, camera.width / 2, camera.height / 2, *flawless]
        return mean, sigma

    def split(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Intrinsics [lenses, intrinsics], poses of the cameras and of the boards [:, 6]."""
        intrinsics = len(self.lens_cameras) * self.intrinsics_count
        parts = np.split(x, [intrinsics, intrinsics + len(self.cameras) * POSE])
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
        lens = self.lens_index[c]
        R = _rotations(camera_pose, start_R)[c]
        turned = np.einsum("nij,nj->ni", _rotations(board_pose, self.rig_from_board[:, :3, :3])[v], self.points)
        in_rig = turned + board_pose[v, 3:]
        rotated = np.einsum("nij,nj->ni", R, in_rig)
        pixel, by_intrinsics, by_point = project_with_jacobian(
            self.lens, intrinsics[lens], rotated + camera_pose[c, 3:]
        )
        by_camera_turn = -by_point @ skew(rotated) @ left_jacobian(np.ascontiguousarray(camera_pose[:, :3]))[c]
        by_rig = by_point @ R
        by_board_turn = -by_rig @ skew(turned) @ left_jacobian(np.ascontiguousarray(board_pose[:, :3]))[v]
        blocks = np.concatenate([by_intrinsics, by_camera_turn, by_point, by_board_turn, by_rig], -1)
        boards = intrinsics.size + camera_pose.size
        column = np.concatenate([
            lens[:, None] * self.intrinsics_count + np.arange(self.intrinsics_count),
            intrinsics.size + c[:, None] * POSE + np.arange(POSE),
            boards + v[:, None] * POSE + np.arange(POSE),
        ], 1)  # fmt: skip
        rows = np.broadcast_to(np.arange(2 * len(c)).reshape(-1, 2, 1), blocks.shape)
        column = np.broadcast_to(column[:, None], blocks.shape)
        matrix = scipy.sparse.csc_array((blocks.ravel(), (rows.ravel(), column.ravel())), shape=(2 * len(c), len(x)))
        return pixel - self.observations.pixel, matrix[:, self.free]


def intrinsics_prior_sigma(camera: Camera) -> Float64[np.ndarray, " intrinsics"]:
    """Standard deviations of the priors of `Camera.intrinsics`, infinite for f."""
    longer = max(camera.width, camera.height)
    scale = {"cx": longer, "cy": longer}
    pinhole = [PRIOR_SIGMA[name] * scale.get(name, 1) for name in PINHOLE_TERMS]
    return np.array([*pinhole, *camera.lens.prior_sigma])


def _rotations(pose: np.ndarray, start: np.ndarray) -> np.ndarray:
    return matrix_from_rotation_vector(np.ascontiguousarray(pose[:, :3])) @ start
