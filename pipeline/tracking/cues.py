"""Image cues of a posed surface beside keypoints: silhouettes and colours."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float64, Int64

from pipeline.base.errors import InputError
from pipeline.geometry.kinematics import Pose, TrackedPoints
from pipeline.geometry.skin import Template, posed
from pipeline.geometry.surface_points import SurfacePoints
from pipeline.tracking.motion_prior import MotionPrior
from pipeline.tracking.pose_solver import DataTerm, joined, solve_poses

LOG = logging.getLogger(__name__)

SETTLED_M = 1e-4
"""Rounds end when vertices move less than this on average, a tenth of what a mask can tell."""

STEPS_PER_ROUND = 4
"""Gauss-Newton steps per round of cues; then what was drawn is out of date."""


@runtime_checkable
class Cue(Protocol):
    """Evidence in images about points of the surface, in all frames."""

    @property
    def points(self) -> SurfacePoints:
        """The points."""

    def at(self, frames: Int64[np.ndarray, " some"]) -> Cue:
        """The cue of some of the frames."""

    def around(self, vertices: Float64[np.ndarray, "frames vertices 3"]) -> DataTerm:
        """The term of the points, linearised around a mesh."""


@dataclass(frozen=True)
class Rounds:
    """At most so many rounds of linearising cues and fitting them, with the keypoints kept."""

    name: str
    cues: Sequence[Cue]
    most: int

    def at(self, frames: Int64[np.ndarray, " some"]) -> Rounds:
        """The same for some of the frames."""
        return Rounds(self.name, [cue.at(frames) for cue in self.cues], self.most)


def posed_vertices(template: Template, pose: Pose) -> Float64[np.ndarray, "frames vertices 3"]:
    """The posed template, world, metres."""
    return posed(template, pose.root_rotation, pose.root_translation, pose.joint_rotations)


def require_finite(vertices: Float64[np.ndarray, "frames vertices 3"]) -> Float64[np.ndarray, "frames vertices 3"]:
    """The vertices of a fit, unless it ran away.

    Raises:
        InputError: if a number is not finite.
    """
    if not np.isfinite(vertices).all():
        raise InputError(
            "keypoints_2d: x, y: expected keypoints that the template can follow, found that its fit runs away; are x "
            "and y exchanged or mirrored, or keypoints named after others?"
        )
    return vertices


def fit_cues(points: TrackedPoints, keypoints: DataTerm, rounds: Rounds, prior: MotionPrior, pose: Pose) -> Pose:
    """Poses that fit keypoints and cues, with the cues linearised anew in every round.

    Args:
        points: the keypoints.
        keypoints: their data term.
        rounds: of cues.
        prior: of the motion.
        pose: to start from.

    Raises:
        InputError: if the fit runs away.
    """
    counts = [len(points.parts), *(len(cue.points) for cue in rounds.cues)]
    together = points
    for cue in rounds.cues:
        together = together.with_surface(cue.points)
    for number in range(rounds.most):
        before = require_finite(posed_vertices(points.template, pose))
        term = joined([keypoints, *(cue.around(before) for cue in rounds.cues)], counts)
        pose, _ = solve_poses(together, term, prior, pose, STEPS_PER_ROUND)
        change = np.linalg.norm(require_finite(posed_vertices(points.template, pose)) - before, axis=-1).mean()
        LOG.info("%s, round %d: vertices moved %.2f mm on average", rounds.name, number + 1, 1e3 * change)
        if change < SETTLED_M:
            break
    return pose
