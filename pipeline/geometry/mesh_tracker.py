"""Keypoints, and masks if there are any, to the pose of every frame: start from triangulated points, refine jointly.

1. Triangulate every keypoint robustly; frames with too few are set aside.
2. Align the rest pose rigidly to each frame, then solve for all poses against the triangulated points.
3. Solve again against the 2D keypoints themselves.
4. Rounds of outline fitting, with the keypoints kept, for what keypoints leave open.
5. Frames set aside are interpolated between their neighbours on the rotation manifold.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from pipeline.base.errors import InputError
from pipeline.geometry.cameras import Camera
from pipeline.geometry.keypoint_targets import KeypointTargets, size_ratio
from pipeline.geometry.kinematics import Pose, TrackedPoints, point_positions, tracked_points
from pipeline.geometry.motion_prior import MotionPrior
from pipeline.geometry.outlines import outline_term, spread_vertices
from pipeline.geometry.pose_solver import align_rigidly, joined, position_term, reprojection_term, solve_poses
from pipeline.geometry.rotations import matrix_from_quaternion, slerp
from pipeline.geometry.silhouettes import View
from pipeline.geometry.skin import Template, posed
from pipeline.geometry.triangulation import reprojection, triangulate

LOG = logging.getLogger(__name__)

SMALLEST_SIGMA_PX = 0.05
"""Keypoints are never trusted further than this: calibration is not better."""

SMALLEST_SIGMA_M = 0.01
"""The start trusts triangulated points to a centimetre, so that it reaches its minimum from a pose far away."""

SETTLED_M = 1e-4
"""Outline rounds end when vertices move less than this on average, a tenth of what a mask can tell."""

OUTLINE_STEPS = 4
"""Gauss-Newton steps per outline round; then the drawn outline is out of date."""

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
class Tracking:
    """Poses, and per frame: whether it was solved or interpolated, and how well its keypoints fit.

    Attributes:
        residual_px: distance of every detected keypoint to the model's, undistorted pixels; NaN where not detected.
        keypoints: number of triangulated keypoints per frame.
        noise_px, sigma_px: standard deviation of a keypoint's coordinate about its triangulated point, and the model's.
        size_ratio: measured over template bone lengths.
    """

    pose: Pose
    solved: Bool[np.ndarray, " frames"]
    residual_px: Float64[np.ndarray, "cameras frames keypoints"]
    keypoints: Int64[np.ndarray, " frames"]
    noise_px: float
    sigma_px: float
    size_ratio: float


def track(
    template: Template, targets: KeypointTargets, observations: Observations, views: Sequence[View],
    prior: MotionPrior, *, inlier_px: float, min_keypoints: int, max_iterations: int, outline_rounds: int,
    outline_sigma_px: float, outline_vertices: int,
) -> Tracking:  # fmt: skip
    """Poses of consecutive frames; `views` may be empty. Other parameters as in `pipeline.config.track_mesh`.

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
    some, prior = observations.at(kept), prior.at(kept)
    sigma_m = np.maximum(found.sigma_m.reshape(frames, count)[kept], SMALLEST_SIGMA_M)
    start = _aligned(points, measured[kept])
    pose, _ = solve_poses(points, position_term(measured[kept], sigma_m), prior, start, max_iterations)
    sigma_px = max(found.noise_px, SMALLEST_SIGMA_PX)
    pose, sigma_px = _fit_keypoints(points, some, prior, pose, sigma_px, max_iterations)
    if views:
        chosen = spread_vertices(template.vertices_rest, outline_vertices)
        views = [view.at(kept) for view in views]
        term = reprojection_term(some.cameras, some.normalised, some.confidence, sigma_px)
        for outline_round in range(outline_rounds):
            before = _posed(template, pose)
            outlines = outline_term(views, before, template.faces, chosen, outline_sigma_px)
            both = points.with_vertices(chosen)
            pose, _ = solve_poses(both, joined([term, outlines], [count, len(chosen)]), prior, pose, OUTLINE_STEPS)
            change = np.linalg.norm(_posed(template, pose) - before, axis=-1).mean()
            LOG.info("outline round %d: vertices moved %.2f mm on average", outline_round + 1, 1e3 * change)
            if change < SETTLED_M:
                break
    pose = fill_between(pose, kept, frames, points.pivot)
    residual = _residual_px(points, observations, pose)
    return Tracking(pose, solved, residual, keypoints, found.noise_px, sigma_px, ratio)


def _posed(template: Template, pose: Pose) -> np.ndarray:
    return posed(template, pose.root_rotation, pose.root_translation, pose.joint_rotations)


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


def fill_between(pose: Pose, known: Int64[np.ndarray, " known"], frames: int, pivot: Float64[np.ndarray, " 3"]) -> Pose:
    """Poses of all `frames` from those of the `known` ones: rotations by slerp and the pivot along a line in between,
    the nearest pose before the first and after the last.
    """
    wanted = np.arange(frames)
    after = np.minimum(np.searchsorted(known, wanted), len(known) - 1)
    before = np.where(known[after] > wanted, np.maximum(after - 1, 0), after)
    at = np.clip((wanted - known[before]) / np.maximum(known[after] - known[before], 1), 0.0, 1.0)
    rotation = slerp(pose.root_rotation[before], pose.root_rotation[after], at)
    pivots = matrix_from_quaternion(pose.root_rotation) @ pivot + pose.root_translation
    between = pivots[before] * (1 - at[:, None]) + pivots[after] * at[:, None]
    joints = slerp(pose.joint_rotations[before], pose.joint_rotations[after], at[:, None])
    return Pose(rotation, between - matrix_from_quaternion(rotation) @ pivot, joints)
