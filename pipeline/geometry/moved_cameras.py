"""Finding a camera that was knocked while the board was recorded: its pose before and after a view differ.

A score test (Rao 1948; of a change at an unknown time: Andrews 1993): how much would the adjusted rig gain from a
second pose of one camera from one view on? It needs no second adjustment, and holds no intrinsics or board pose fixed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.stats
from jaxtyping import Int64

from pipeline.geometry.rig import Rig
from pipeline.geometry.rig_model import POSE, Observations

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


def find_moved(rig: Rig, time: Int64[np.ndarray, " views"]) -> Moved | None:
    """The camera that most gains from a second pose; None if no gain is more than noise.

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
    camera, when = max(gains, key=lambda key: gains[key][0])
    gain, shift = gains[camera, when]
    if scipy.stats.chi2.sf(gain, POSE) * len(gains) > FALSE_ALARM:
        return None
    best = {c: max(value for (k, _), (value, _) in gains.items() if k == c) for c, _ in gains}
    rivals = [c for c in best if c != camera and best[c] > AS_GOOD * gain]
    return Moved([camera, *rivals], when, gain, shift)


def _gains(rig: Rig, camera: int, time: np.ndarray) -> list[tuple[int, tuple[float, float]]]:
    """For each view of a camera but its first: (its time, (chi-square of a second pose from there on, shift))."""
    mine = np.flatnonzero(rig.model.observations.camera == camera)
    jacobian = rig.model.residuals(rig.parameters)[1].tocsr()[np.repeat(2 * mine, 2) + np.tile([0, 1], len(mine))]
    used = np.unique(jacobian.indices)
    position = np.searchsorted(rig.model.free, rig.model.pose_columns(camera))
    by_pose, by_all = jacobian[:, position].toarray(), jacobian[:, used].toarray()
    weight = np.repeat(rig.weight[mine], 2) / rig.sigma_px**2
    weighted = by_pose * weight[:, None]
    inverse = rig.normal_inverse[np.ix_(used, used)]
    # The scores of a robust fit vary less than its curvature says: E psi^2 / E w, 0.54 for Gaussian noise.
    scores = (rig.weight**2 * (rig.residual**2).sum(1)).mean() / (2 * rig.sigma_px**2 * rig.weight.mean())
    scale = np.sqrt((weighted * by_pose).sum(0))  # metres and radians on one footing
    found = []
    for when in np.unique(time[mine])[1:]:
        after = np.repeat(time[mine] >= when, 2)
        cross = weighted[after].T @ by_all[after]
        gradient = weighted[after].T @ rig.residual[mine].ravel()[after]
        curvature = weighted[after].T @ by_pose[after] - cross @ inverse @ cross.T
        value, vector = np.linalg.eigh(curvature / np.outer(scale, scale))
        told = value > LEAST_INFORMATION
        score = vector[:, told].T @ (gradient / scale)
        step = -vector[:, told] @ (score / value[told]) / scale
        shift = np.sqrt(((by_pose[after] @ step) ** 2).sum() / max(after.sum() / 2, 1))
        found.append((int(when), (float((score**2 / value[told]).sum() / scores), float(shift))))
    return found


def split_camera(
    observations: Observations, time: Int64[np.ndarray, " views"], camera: int, when: int, new: int
) -> Observations:
    """The same observations, those of `camera` from `when` on as camera number `new`."""
    later = (observations.camera == camera) & (time[observations.view] >= when)
    return Observations(
        np.where(later, new, observations.camera), observations.view, observations.corner, observations.pixel
    )
