"""Keypoints, and masks if there are any, to the pose of every frame: start from triangulated points, refine jointly.

1. Triangulate every keypoint robustly; frames with too few are set aside.
2. Align the rest pose rigidly to each frame, then solve for all poses against the triangulated points.
3. Solve again against the 2D keypoints themselves.
4. Rounds of fitting what else the images show (`Cue`), with the keypoints kept, for what keypoints leave open.
5. Well lit frames are refined with more (their colours); the corrections are carried to the frames between them, on
   the rotation manifold, where their own keypoints correct them again.
6. Frames set aside are interpolated between their neighbours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from pipeline.base.errors import InputError
from pipeline.geometry.cameras import Camera
from pipeline.geometry.carrying import carry_corrections, fill_between
from pipeline.geometry.cues import Rounds, fit_cues
from pipeline.geometry.keypoint_targets import KeypointTargets, size_ratio
from pipeline.geometry.kinematics import Pose, TrackedPoints, point_positions, tracked_points
from pipeline.geometry.motion_prior import MotionPrior
from pipeline.geometry.pose_solver import align_rigidly, position_term, reprojection_term, solve_poses
from pipeline.geometry.skin import Template
from pipeline.geometry.triangulation import reprojection, triangulate

SMALLEST_SIGMA_PX = 0.05
"""Keypoints are never trusted further than this: calibration is not better."""

SMALLEST_SIGMA_M = 0.01
"""The start trusts triangulated points to a centimetre, so that it reaches its minimum from a pose far away."""

CARRIED_RAD = 0.05
"""How far a joint may be from where the refined frames around it put it: 3 degrees, what a single frame's keypoints leave
open (half a pixel, 5 mm, at both ends of a 0.2 m bone), so that they correct a carried pose but do not undo it."""

WELL_SEEN = 0.5
"""Frames with this share of the best frame's keypoints are aligned on their own; the others start between them."""

MEDIAN_OF_LENGTH = 1.1774100225154747
"""Median length of a vector of two standard normal coordinates, sqrt(2 ln 2)."""


@dataclass(frozen=True)
class Observations:
    """Keypoints of consecutive frames in normalised image coordinates (`Camera.undistort`); NaN where not detected."""

    cameras: Sequence[Camera]
    normalised: Float64[np.ndarray, "cameras frames keypoints 2"]
    confidence: Float64[np.ndarray, "cameras frames keypoints"]

    def at(self, frames: np.ndarray) -> Observations:
        """Those of some of the frames."""
        return Observations(self.cameras, self.normalised[:, frames], self.confidence[:, frames])


@dataclass(frozen=True)
class Refinement:
    """What the best lit frames are refined with.

    Attributes:
        frames: to refine.
        rounds: for these.
        others: for the frames between them, once corrected like these.
    """

    frames: Int64[np.ndarray, " refined"]
    rounds: Sequence[Rounds]
    others: Sequence[Rounds]


@dataclass(frozen=True)
class Tracking:
    """Poses, and per frame: how it was found, and how well its keypoints fit.

    Attributes:
        status: [frames] of text: "tracked" by keypoints and outlines; "refined" by images as well; "carried": tracked,
            with the corrections of the refined frames around it; "interpolated": too few keypoints.
        residual_px: distance of every detected keypoint to the model's, undistorted pixels; NaN where not detected.
        keypoints: number of triangulated keypoints per frame.
        noise_px, sigma_px: standard deviation of a keypoint's coordinate about its triangulated point, and the model's.
        size_ratio: measured over template bone lengths.
    """

    pose: Pose
    status: np.ndarray
    residual_px: Float64[np.ndarray, "cameras frames keypoints"]
    keypoints: Int64[np.ndarray, " frames"]
    noise_px: float
    sigma_px: float
    size_ratio: float


def track(
    template: Template, targets: KeypointTargets, observations: Observations, prior: MotionPrior,
    schedule: Sequence[Rounds], refinement: Refinement | None = None, *, inlier_px: float, min_keypoints: int,
    max_iterations: int,
) -> Tracking:  # fmt: skip
    """Poses of consecutive frames. `schedule` may be empty; other parameters as in `pipeline.config.track_mesh`.

    Raises:
        InputError: if no frame has enough keypoints, or the template's unit is wrong.
    """
    points = tracked_points(template, targets.joints, targets.vertices)
    count, frames = len(targets.names), observations.normalised.shape[1]
    flat = observations.normalised.reshape(len(observations.cameras), -1, 2)
    confidence = observations.confidence.reshape(len(observations.cameras), -1)
    found = triangulate(observations.cameras, flat, confidence, inlier_px)
    measured = found.points.reshape(frames, count, 3)
    keypoints = np.isfinite(measured).all(-1).sum(1)
    solved = keypoints >= min_keypoints
    if not solved.any():
        raise InputError(
            f"keypoints_2d: expected a frame with {min_keypoints} keypoints on which two cameras agree within "
            f"{inlier_px:g} px, found none; check cameras.json, downsample_from_sensor and inlier_px"
        )
    ratio = size_ratio(template, targets, measured, point_positions(points, points.rest_pose(1))[0])
    kept = np.flatnonzero(solved)
    some, takes, prior = observations.at(kept), prior.takes, prior.at(kept)
    sigma_m = np.maximum(found.sigma_m.reshape(frames, count)[kept], SMALLEST_SIGMA_M)
    start = _aligned(points, measured[kept])
    pose, _ = solve_poses(points, position_term(measured[kept], sigma_m), prior, start, max_iterations)
    sigma_px = max(found.noise_px, SMALLEST_SIGMA_PX)
    pose, sigma_px = _fit_keypoints(points, some, prior, pose, sigma_px, max_iterations)
    term = reprojection_term(some.cameras, some.normalised, some.confidence, sigma_px)
    for rounds in schedule:
        pose = fit_cues(points, term, rounds.at(kept), prior, pose)
    status = np.where(solved, "tracked", "interpolated")
    if refinement is not None:
        known = np.flatnonzero(np.isin(kept, refinement.frames))
        if len(known):
            pose = _refine(points, some, sigma_px, refinement, kept, known, prior, pose)
            status[kept] = "carried"
            status[kept[known]] = "refined"
    pose = fill_between(pose, kept, frames, points.pivot, takes)
    residual = _residual_px(points, observations, pose)
    return Tracking(pose, status, residual, keypoints, found.noise_px, sigma_px, ratio)


def _refine(
    points: TrackedPoints, observations: Observations, sigma_px: float, refinement: Refinement,
    kept: Int64[np.ndarray, " kept"], known: Int64[np.ndarray, " known"], prior: MotionPrior, pose: Pose,
) -> Pose:  # fmt: skip
    """Refine the `known` ones of the `kept` frames; carry what changed to the others and fit their own keypoints."""
    few = observations.at(known)
    term = reprojection_term(few.cameras, few.normalised, few.confidence, sigma_px)
    refined = pose.at(known)
    for rounds in refinement.rounds:
        refined = fit_cues(points, term, rounds.at(kept[known]), prior.at(known), refined)
    carried = carry_corrections(pose, refined, known, points.pivot, prior.takes)
    if len(known) == len(kept):
        return refined
    term = reprojection_term(observations.cameras, observations.normalised, observations.confidence, sigma_px)
    prior = replace(prior, expected=carried.joint_rotations, rest_rotation=CARRIED_RAD)
    for rounds in refinement.others:
        carried = fit_cues(points, term, rounds.at(kept), prior, carried)
    return carried.replaced(known, refined)


def _residual_px(points: TrackedPoints, observations: Observations, pose: Pose) -> np.ndarray:
    flat = observations.normalised.reshape(len(observations.cameras), -1, 2)
    length, _, _ = reprojection(observations.cameras, flat, point_positions(points, pose).reshape(-1, 3))
    return np.where(np.isfinite(flat).all(-1), length, np.nan).reshape(observations.confidence.shape)


def _fit_keypoints(
    points: TrackedPoints, observations: Observations, prior: MotionPrior, pose: Pose, sigma_px: float, iterations: int
) -> tuple[Pose, float]:
    """Fit the 2D keypoints, twice: what the model cannot follow (a joint the detector sees elsewhere) shows in the
    residuals of the first fit, and is noise to the second.
    """
    for _ in range(2):
        term = reprojection_term(observations.cameras, observations.normalised, observations.confidence, sigma_px)
        pose, _ = solve_poses(points, term, prior, pose, iterations)
        residual = _residual_px(points, observations, pose)
        sigma_px = max(float(np.nanmedian(residual)) / MEDIAN_OF_LENGTH, SMALLEST_SIGMA_PX)
    return pose, sigma_px


def _aligned(points: TrackedPoints, measured: Float64[np.ndarray, "frames keypoints 3"]) -> Pose:
    """The rest pose aligned rigidly to each frame that is well seen, and interpolated between those."""
    known = np.isfinite(measured).all(-1)
    well = np.flatnonzero(known.sum(1) >= WELL_SEEN * known.sum(1).max())
    rest = points.rest_pose(len(well))
    source = point_positions(points, rest)[0]
    rotation, translation = np.zeros((len(well), 4)), np.zeros((len(well), 3))
    for row, frame in enumerate(well):
        use = known[frame]
        rotation[row], translation[row] = align_rigidly(source[use], measured[frame, use], np.ones(use.sum()))
    return fill_between(Pose(rotation, translation, rest.joint_rotations), well, len(measured), points.pivot)
