"""Detection of a camera that was knocked while the board was recorded.

Its pose before and after a view differ.

A score test (Rao 1948; of a change at an unknown time: Andrews 1993): how much would the adjusted rig gain from a
second pose of one camera from one view on? It needs no second adjustment, and holds no intrinsics or board pose fixed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Int64

from pipeline.base.distributions import chi2_tail, f_tail
from pipeline.calibration.cameras.rig import Rig
from pipeline.calibration.cameras.rig_inputs import Observations
from pipeline.calibration.cameras.rig_model import POSE

FALSE_ALARM = 1e-6
"""Probability that a rig in which nothing moved is suspected, over all its cameras and views: never in practice."""

AS_GOOD = 0.95
"""A camera that explains so much of the best camera's gain is as suspect: of two cameras, either may have moved."""

LEAST_INFORMATION = 1e-6
"""Share of a pose's information that must be left when all else may follow it. A camera that sees boards alone has
none: they follow it wherever it goes, and what is left is rounding, about 1e-9."""


@dataclass(frozen=True)
class Moved:
    """A camera whose pose differs from a view on.

    Attributes:
        suspects: the camera, first, and those that would explain the views as well.
        time: number of the first view after the change.
        gain: chi-square of the six parameters of a second pose.
        shift_px: root mean square of how far its corners moved; a lower bound where the motion is large, because
            the robust adjustment has then taken one of the two poses for gross errors.
    """

    suspects: list[int]
    time: int
    gain: float
    shift_px: float


@dataclass(frozen=True)
class _Gain:
    """Chi-square and degrees of freedom of a second pose, and the shift.

    Beside those of a pose per view beyond it.
    """

    gain: float
    freedom: int
    rest: float
    rest_freedom: int
    shift_px: float

    @property
    def misfit(self) -> float:
        """Gain of each of the other differences between views, 1 if they are noise, and not less."""
        return max(1.0, self.rest / self.rest_freedom) if self.rest_freedom else 1.0

    @property
    def strength(self) -> float:
        """The gain in units of misfit."""
        return self.gain / self.misfit

    @property
    def chance(self) -> float:
        """Probability of the gain where nothing moves.

        Neither noise (chi-square) nor misfit (F) may explain it.
        """
        if self.freedom == 0:
            return 1.0
        by_noise = chi2_tail(self.gain, self.freedom)
        if self.rest_freedom == 0:
            return by_noise
        by_misfit = f_tail(self.gain / self.freedom / self.misfit, self.freedom, self.rest_freedom)
        return max(by_noise, by_misfit)


def find_moved(rig: Rig, time: Int64[np.ndarray, " views"]) -> Moved | None:
    """Find the camera that most gains from a second pose.

    None if no gain is more than noise and misfit.

    Args:
        time: of each of the rig's views, the number of the shot: they were recorded in this order.
    """
    gains = {
        (c, when): found
        for c in range(len(rig.cameras))
        for when, found in _gains(rig, c, time[rig.model.observations.view])
    }
    if not gains:
        return None
    camera, when = max(gains, key=lambda key: gains[key].strength)
    found = gains[camera, when]
    if found.chance * len(gains) > FALSE_ALARM:
        return None
    best = {c: max(each.strength for (k, _), each in gains.items() if k == c) for c, _ in gains}
    rivals = [c for c in best if c != camera and best[c] > AS_GOOD * found.strength]
    return Moved([camera, *rivals], when, found.gain, found.shift_px)


def _gains(rig: Rig, camera: int, time: np.ndarray) -> list[tuple[int, _Gain]]:
    """Gain of a second pose from each view of a camera on but its first.

    In pairs with the view's time.
    """
    mine = np.flatnonzero(rig.model.observations.camera == camera)
    times, number = np.unique(time[mine], return_inverse=True)
    scores, curvature, by_pose, scale = _pose_per_view(rig, camera, mine, number.ravel())
    all_told, all_gain, _ = _solved(scores.ravel(), _flat(curvature), np.tile(scale, len(times)))
    found = []
    for first in range(1, len(times)):
        after = slice(first, None)
        told, gain, step = _solved(scores[after].sum(0), curvature[after][:, :, after].sum((0, 2)), scale)
        moved = by_pose[np.repeat(number.ravel() >= first, 2)] @ step
        shift = float(np.sqrt((moved**2).sum() / max(len(moved) / 2, 1)))
        rest = max(all_gain - gain, 0.0), max(all_told - told, 0)  # what is told of a sum may not be of its parts
        found.append((int(times[first]), _Gain(gain, told, *rest, shift)))
    return found


def _pose_per_view(
    rig: Rig, camera: int, mine: np.ndarray, number: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Score test of a camera pose per view.

    If each view had a camera pose of its own: the scores of these poses [views, 6], whose covariance is the curvature
    that is left of them when all else follows [views, 6, views, 6]; corners by pose [2 corners, 6]; and the scale of a
    pose [6], which puts metres and radians on one footing.
    """
    jacobian = rig.model.residuals(rig.parameters)[1][np.repeat(2 * mine, 2) + np.tile([0, 1], len(mine))]
    used = np.unique(jacobian.indices)
    position = np.searchsorted(rig.model.free, rig.model.pose_columns(camera))
    by_pose = jacobian[:, position].toarray()
    weighted = by_pose * np.repeat(rig.weight[mine], 2)[:, None] / rig.sigma_px**2
    views = number.max() + 1
    gradient, cross = np.zeros((views, POSE)), np.zeros((views, POSE, len(used)))
    curvature = np.zeros((views, POSE, views, POSE))
    by_all = jacobian[:, used]
    for v in range(views):
        rows = np.repeat(number == v, 2)
        gradient[v] = weighted[rows].T @ rig.residual[mine].ravel()[rows]
        cross[v] = (by_all[rows].T @ weighted[rows]).T
        curvature[v, :, v] = weighted[rows].T @ by_pose[rows]
    flat = cross.reshape(-1, len(used))
    curvature -= (flat @ rig.normal_inverse[np.ix_(used, used)] @ flat.T).reshape(curvature.shape)
    # The scores of a robust fit vary less than its curvature says: E psi^2 / E w, 0.54 for Gaussian noise.
    variance = (rig.weight**2 * (rig.residual**2).sum(1)).mean() / (2 * rig.sigma_px**2 * rig.weight.mean())
    return gradient / np.sqrt(variance), curvature, by_pose, np.sqrt((weighted * by_pose).sum(0))


def _flat(blocks: np.ndarray) -> np.ndarray:
    return blocks.reshape(blocks.shape[0] * blocks.shape[1], -1)


def _solved(score: np.ndarray, curvature: np.ndarray, scale: np.ndarray) -> tuple[int, float, np.ndarray]:
    """Directions that are told, score^T curvature^-1 score over them, and the step that they ask for."""
    value, vector = np.linalg.eigh(curvature / np.outer(scale, scale))
    told = value > LEAST_INFORMATION
    along = vector[:, told].T @ (score / scale)
    return int(told.sum()), float((along**2 / value[told]).sum()), -vector[:, told] @ (along / value[told]) / scale


def split_camera(
    observations: Observations, time: Int64[np.ndarray, " views"], camera: int, when: int, new: int
) -> Observations:
    """The same observations, those of `camera` from `when` on as camera number `new`."""
    later = (observations.camera == camera) & (time[observations.view] >= when)
    return replace(observations, camera=np.where(later, new, observations.camera))
