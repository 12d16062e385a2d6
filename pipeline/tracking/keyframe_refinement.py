"""Refinement of fully lit keyframes, with their corrections interpolated between them.

Keyframes are fitted to more than keypoints and silhouettes (their images); the frames between them start from the
keyframes' corrections, and their own keypoints and silhouettes correct them again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from pipeline.geometry.kinematics import Pose, TrackedPoints
from pipeline.geometry.pose_interpolation import carry_corrections
from pipeline.tracking.cues import Rounds, fit_cues, posed_vertices
from pipeline.tracking.motion_prior import MotionPrior
from pipeline.tracking.pose_solver import DataTerm
from pipeline.tracking.vertex_offsets import fit_offsets, skinning_jacobians

CORRECTED_POSE_RAD = 0.05
"""How far a joint may be from where the keyframes around it put it: 3 degrees, what one frame's keypoints leave open
(half a pixel, 5 mm, at both ends of a 0.2 m bone), so that they correct an interpolated pose but do not undo it."""


@dataclass(frozen=True)
class KeyframeRefinement:
    """Keyframes, and the rounds of cues that they and the frames between them are fitted to.

    Attributes:
        frames: the keyframes.
        rounds: for these; the last one's cues move single vertices as well.
        others: for the frames between them, once corrected like these.
        offset_m: typical offset of a vertex from the posed template; 0: none.
    """

    frames: Int64[np.ndarray, " refined"]
    rounds: Sequence[Rounds]
    others: Sequence[Rounds]
    offset_m: float

    def at(self, kept: Int64[np.ndarray, " kept"]) -> KeyframeRefinement:
        """The same for the `kept` frames only, numbered among these."""
        return KeyframeRefinement(
            np.flatnonzero(np.isin(kept, self.frames)), [rounds.at(kept) for rounds in self.rounds],
            [rounds.at(kept) for rounds in self.others], self.offset_m,
        )  # fmt: skip


def refine_keyframes(
    points: TrackedPoints, keypoint_term: Callable[[np.ndarray], DataTerm], refinement: KeyframeRefinement,
    prior: MotionPrior, pose: Pose,
) -> tuple[Pose, Float64[np.ndarray, "refined vertices 3"]]:  # fmt: skip
    """Poses of all frames, and vertex offsets (before skinning, metres) of the keyframes.

    Args:
        points: the keypoints.
        keypoint_term: their data term in some of the frames.
        refinement: of these frames; it has at least one keyframe.
        prior: of the motion.
        pose: of all frames, to start from.
    """
    known = refinement.frames
    refined = pose.at(known)
    for rounds in refinement.rounds:
        refined = fit_cues(points, keypoint_term(known), rounds.at(known), prior.at(known), refined)
    vertices = posed_vertices(points.template, refined)
    offsets = np.zeros_like(vertices)
    if refinement.offset_m:
        cues = refinement.rounds[-1].at(known).cues
        jacobians = skinning_jacobians(points.template, refined)
        offsets = fit_offsets(points.template, vertices, jacobians, cues, refinement.offset_m)
    corrected = carry_corrections(pose, refined, known, points.pivot, prior.takes)
    near = replace(prior, expected=corrected.joint_rotations, rest_rotation=CORRECTED_POSE_RAD)
    if len(known) < len(pose):
        for rounds in refinement.others:
            corrected = fit_cues(points, keypoint_term(np.arange(len(pose))), rounds, near, corrected)
    return corrected.replaced(known, refined), offsets
