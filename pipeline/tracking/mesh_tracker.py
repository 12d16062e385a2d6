"""Tracking of a rigged template: the pose of every frame from keypoints and other cues.

1. Triangulate every keypoint robustly; frames with too few are set aside.
2. Align the rest pose rigidly to each frame, then solve for all poses against the triangulated points.
3. Solve again against the 2D keypoints themselves.
4. Rounds of fitting what else the images show (`Cue`), with the keypoints kept, for what keypoints leave open.
5. Fully lit keyframes are refined by their colours; the corrections are interpolated to the frames between them, on
   the rotation manifold, where their own keypoints correct them again.
6. Frames set aside are interpolated between their neighbours.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from pipeline.base.errors import InputError
from pipeline.geometry.cameras import Camera
from pipeline.geometry.kinematics import Pose, TrackedPoints, point_positions, tracked_points
from pipeline.geometry.pose_interpolation import carry_offsets, fill_between
from pipeline.geometry.skin import Template
from pipeline.geometry.triangulation import Triangulation, reprojection, triangulate
from pipeline.tracking.cues import Rounds, fit_cues
from pipeline.tracking.keyframe_refinement import KeyframeRefinement, refine_keyframes
from pipeline.tracking.keypoint_targets import KeypointTargets, size_ratio
from pipeline.tracking.left_right_swaps import exchanged, find_left_right_swaps
from pipeline.tracking.motion_prior import MotionPrior
from pipeline.tracking.pose_solver import DataTerm, align_rigidly, position_term, reprojection_term, solve_poses

LOG = logging.getLogger(__name__)

SMALLEST_SIGMA_PX = 0.05
"""Keypoints are never trusted further than this: calibration is not better."""

SMALLEST_SIGMA_M = 0.01
"""The start trusts triangulated points to a centimetre, so that it reaches its minimum from a pose far away."""

WELL_SEEN = 0.5
"""Frames with this share of the best frame's keypoints are aligned on their own; the others start between them."""

MEDIAN_OF_LENGTH = 1.1774100225154747
"""Median length of a vector of two standard normal coordinates, sqrt(2 ln 2)."""


@dataclass(frozen=True)
class Observations:
    """Keypoints of consecutive frames in normalised image coordinates; NaN where not detected.

    `Camera.undistort` makes these coordinates.
    """

    cameras: Sequence[Camera]
    normalised: Float64[np.ndarray, "cameras frames keypoints 2"]
    confidence: Float64[np.ndarray, "cameras frames keypoints"]

    def at(self, frames: np.ndarray) -> Observations:
        """The keypoints of some of the frames."""
        return Observations(self.cameras, self.normalised[:, frames], self.confidence[:, frames])


@dataclass(frozen=True)
class Tracking:
    """Poses, and per frame: how it was found, and how well its keypoints fit.

    Attributes:
        offsets: of the vertices before skinning, metres; see `pipeline.tracking.vertex_offsets`.
        status: [frames] of text: "tracked" by keypoints and silhouettes; "refined" by images as well; "carried":
            tracked, with the corrections of the keyframes around it; "interpolated": too few keypoints.
        residual_px: distance of every detected keypoint to the model's, undistorted pixels; NaN where not detected.
        keypoints_m, keypoint_sigma_m: triangulated, and the standard deviation of each (root mean square over axes);
            NaN where fewer than two cameras agree.
        noise_px, sigma_px: standard deviation of a keypoint's coordinate about its triangulated point, and the model's.
        size_ratio: measured over template bone lengths.
    """

    pose: Pose
    offsets: Float64[np.ndarray, "frames vertices 3"]
    status: np.ndarray
    residual_px: Float64[np.ndarray, "cameras frames keypoints"]
    keypoints_m: Float64[np.ndarray, "frames keypoints 3"]
    keypoint_sigma_m: Float64[np.ndarray, "frames keypoints"]
    noise_px: float
    sigma_px: float
    size_ratio: float


@dataclass(frozen=True)
class TrackingLimits:
    """Limits of using keypoints and of solving.

    Attributes:
        inlier_px: largest distance of a good keypoint from where others see it, undistorted pixels.
        min_keypoints: frames with fewer triangulated keypoints are interpolated.
        max_iterations: of each solve.
    """

    inlier_px: float
    min_keypoints: int
    max_iterations: int


def track(
    template: Template, targets: KeypointTargets, observations: Observations, prior: MotionPrior,
    schedule: Sequence[Rounds], limits: TrackingLimits, refinement: KeyframeRefinement | None = None,
) -> Tracking:  # fmt: skip
    """Poses of consecutive frames; `schedule` may be empty.

    Raises:
        InputError: if no frame has enough keypoints, the template's unit is wrong, or no pose fits at all.
    """
    points = tracked_points(template, targets.joints, targets.vertices)
    count, frames = len(targets.names), observations.normalised.shape[1]
    observations, found = triangulate_unswapped(observations, targets.names, limits.inlier_px)
    measured, sigma_m = found.points.reshape(frames, count, 3), found.sigma_m.reshape(frames, count)
    keypoints = np.isfinite(measured).all(-1).sum(1)
    solved = solvable_frames(keypoints, limits)
    ratio = size_ratio(template, targets, measured, point_positions(points, points.rest_pose(1))[0])
    kept = np.flatnonzero(solved)
    some, takes, prior = observations.at(kept), prior.takes, prior.at(kept)
    start = _aligned(points, measured[kept])
    positions = position_term(measured[kept], np.maximum(sigma_m[kept], SMALLEST_SIGMA_M))
    pose, _ = solve_poses(points, positions, prior, start, limits.max_iterations)
    sigma_px = max(found.noise_px, SMALLEST_SIGMA_PX)
    pose, sigma_px = _fit_keypoints(points, some, prior, pose, sigma_px, limits.max_iterations)

    def keypoint_term(frames: np.ndarray) -> DataTerm:
        few = some.at(frames)
        return reprojection_term(few.cameras, few.normalised, few.confidence, sigma_px)

    for rounds in schedule:
        pose = fit_cues(points, keypoint_term(np.arange(len(kept))), rounds.at(kept), prior, pose)
    offsets = np.zeros((frames, len(template.vertices_rest), 3))
    status = np.where(solved, "tracked", "interpolated")
    known = np.flatnonzero(np.isin(kept, [] if refinement is None else refinement.frames))
    if refinement is not None and len(known):
        pose, found_offsets = refine_keyframes(points, keypoint_term, refinement.at(kept), prior, pose)
        offsets = carry_offsets(found_offsets, kept[known], frames, takes)
        status[kept], status[kept[known]] = "carried", "refined"
    pose = fill_between(pose, kept, frames, points.pivot, takes)
    residual = keypoint_residuals_px(observations, point_positions(points, pose))
    return Tracking(pose, offsets, status, residual, measured, sigma_m, found.noise_px, sigma_px, ratio)


def solvable_frames(keypoints: Int64[np.ndarray, " frames"], limits: TrackingLimits) -> Bool[np.ndarray, " frames"]:
    """Frames with enough triangulated keypoints to be solved.

    Raises:
        InputError: if there is none.
    """
    solved = keypoints >= limits.min_keypoints
    if not solved.any():
        raise InputError(
            f"keypoints_2d: expected a frame with {limits.min_keypoints} keypoints on which two cameras agree within "
            f"{limits.inlier_px:g} px, found none; check cameras.json, downsample_from_sensor and inlier_px"
        )
    return solved


def triangulate_unswapped(
    observations: Observations, names: Sequence[str], inlier_px: float
) -> tuple[Observations, Triangulation]:
    """Observations with left-right swaps put right, and their triangulation."""
    found = _triangulated(observations, inlier_px)
    points = found.points.reshape(*observations.normalised.shape[1:3], 3)
    swaps = find_left_right_swaps(observations.cameras, observations.normalised, points, inlier_px)
    if not len(swaps):
        return observations, found
    pairs = sorted({f"{names[a]}/{names[b]}" for a, b in swaps[:, 2:]})
    LOG.warning("%d pairs of keypoints were exchanged in one view and are put right: %s", len(swaps), ", ".join(pairs))
    normalised, confidence = exchanged(observations.normalised, swaps), exchanged(observations.confidence, swaps)
    observations = Observations(observations.cameras, normalised, confidence)
    return observations, _triangulated(observations, inlier_px)


def _triangulated(observations: Observations, inlier_px: float) -> Triangulation:
    flat = observations.normalised.reshape(len(observations.cameras), -1, 2)
    return triangulate(observations.cameras, flat, observations.confidence.reshape(len(flat), -1), inlier_px)


def keypoint_residuals_px(
    observations: Observations, points: Float64[np.ndarray, "frames keypoints 3"]
) -> Float64[np.ndarray, "cameras frames keypoints"]:
    """Distance of keypoints to their points, undistorted pixels; NaN where not detected."""
    flat = observations.normalised.reshape(len(observations.cameras), -1, 2)
    length, _, _ = reprojection(observations.cameras, flat, points.reshape(-1, 3))
    return np.where(np.isfinite(flat).all(-1), length, np.nan).reshape(observations.confidence.shape)


def _fit_keypoints(
    points: TrackedPoints, observations: Observations, prior: MotionPrior, pose: Pose, sigma_px: float, iterations: int
) -> tuple[Pose, float]:
    """Fit the 2D keypoints, twice.

    What the model cannot follow (a joint that the detector sees elsewhere) shows in the residuals of the first fit,
    and is noise to the second.
    """
    for _ in range(2):
        term = reprojection_term(observations.cameras, observations.normalised, observations.confidence, sigma_px)
        pose, _ = solve_poses(points, term, prior, pose, iterations)
        residual = keypoint_residuals_px(observations, point_positions(points, pose))
        sigma_px = max(float(np.nanmedian(residual)) / MEDIAN_OF_LENGTH, SMALLEST_SIGMA_PX)
    return pose, sigma_px


def _aligned(points: TrackedPoints, measured: Float64[np.ndarray, "frames keypoints 3"]) -> Pose:
    """The rest pose aligned rigidly to each well seen frame, and interpolated between these."""
    known = np.isfinite(measured).all(-1)
    well = np.flatnonzero(known.sum(1) >= WELL_SEEN * known.sum(1).max())
    rest = points.rest_pose(len(well))
    source = point_positions(points, rest)[0]
    rotation, translation = np.zeros((len(well), 4)), np.zeros((len(well), 3))
    for row, frame in enumerate(well):
        use = known[frame]
        rotation[row], translation[row] = align_rigidly(source[use], measured[frame, use], np.ones(use.sum()))
    return fill_between(Pose(rotation, translation, rest.joint_rotations), well, len(measured), points.pivot)
