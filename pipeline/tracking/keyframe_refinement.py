"""Well lit frames refined with more than keypoints and outlines, and what they learn carried to the frames between."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from pipeline.geometry.kinematics import Pose, TrackedPoints
from pipeline.geometry.pose_interpolation import carry_corrections
from pipeline.tracking.cues import Rounds, fit_cues, vertices_of
from pipeline.tracking.motion_prior import MotionPrior
from pipeline.tracking.pose_solver import DataTerm
from pipeline.tracking.vertex_offsets import carrying_matrices, fit_offsets

CARRIED_RAD = 0.05
"""How far a joint may be from where the refined frames around it put it: 3 degrees, what one frame's keypoints leave
open (half a pixel, 5 mm, at both ends of a 0.2 m bone), so that they correct a carried pose but do not undo it."""


@dataclass(frozen=True)
class Refinement:
    """What the best lit frames are refined with.

    Attributes:
        frames: to refine.
        rounds: for these; the last one's cues move single vertices as well.
        others: for the frames between them, once corrected like these.
        offset_m: typical offset of a vertex from the posed template; 0: none.
    """

    frames: Int64[np.ndarray, " refined"]
    rounds: Sequence[Rounds]
    others: Sequence[Rounds]
    offset_m: float

    def at(self, kept: Int64[np.ndarray, " kept"]) -> Refinement:
        """The same for the `kept` frames only, numbered among these."""
        return Refinement(
            np.flatnonzero(np.isin(kept, self.frames)), [rounds.at(kept) for rounds in self.rounds],
            [rounds.at(kept) for rounds in self.others], self.offset_m,
        )  # fmt: skip


def refine(
    points: TrackedPoints, keypoint_term: Callable[[np.ndarray], DataTerm], refinement: Refinement, prior: MotionPrior,
    pose: Pose,
) -> tuple[Pose, Float64[np.ndarray, "refined vertices 3"]]:  # fmt: skip
    """Poses of all frames, and vertex offsets (before skinning, metres) of the refined ones.

    Args:
        points: the keypoints.
        keypoint_term: their data term in some of the frames.
        refinement: of these frames; it has some to refine.
        prior: of the motion.
        pose: of all frames, to start from.
    """
    known = refinement.frames
    refined = pose.at(known)
    for rounds in refinement.rounds:
        refined = fit_cues(points, keypoint_term(known), rounds.at(known), prior.at(known), refined)
    vertices = vertices_of(points.template, refined)
    offsets = np.zeros_like(vertices)
    if refinement.offset_m:
        cues = refinement.rounds[-1].at(known).cues
        carrying = carrying_matrices(points.template, refined)
        offsets = fit_offsets(points.template, vertices, carrying, cues, refinement.offset_m)
    carried = carry_corrections(pose, refined, known, points.pivot, prior.takes)
    near = replace(prior, expected=carried.joint_rotations, rest_rotation=CARRIED_RAD)
    if len(known) < len(pose):
        for rounds in refinement.others:
            carried = fit_cues(points, keypoint_term(np.arange(len(pose))), rounds, near, carried)
    return carried.replaced(known, refined), offsets
