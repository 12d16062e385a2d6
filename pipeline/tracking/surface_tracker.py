"""Tracking of an unrigged template: a root transform and smooth offsets per frame.

1. Triangulate every keypoint robustly; frames with too few are set aside.
2. Align the rest shape rigidly to each frame, then fit root and offsets of all frames to the triangulated points.
3. Fit them to the 2D keypoints themselves; from here on, what has not moved is held still.
4. Rounds of fitting cues (silhouettes, images), with the keypoints kept.
5. Frames set aside are interpolated between their neighbours, rotations on their manifold.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from pipeline.geometry.kinematics import Pose, tracked_points
from pipeline.geometry.pose_interpolation import fill_between, neighbours
from pipeline.geometry.rigid_alignment import align_rigid
from pipeline.geometry.rotations import quaternion_from_matrix
from pipeline.geometry.skin import Template
from pipeline.geometry.surface_points import at_vertices
from pipeline.tracking.cues import SETTLED_M, Rounds
from pipeline.tracking.deformation_basis import deformation_basis
from pipeline.tracking.keypoint_targets import KeypointTargets, size_ratio
from pipeline.tracking.mesh_tracker import (
    MEDIAN_OF_LENGTH,
    SMALLEST_SIGMA_PX,
    Observations,
    Tracking,
    TrackingLimits,
    keypoint_residuals_px,
    solvable_frames,
    triangulate_unswapped,
)
from pipeline.tracking.motion_prior import MotionPrior
from pipeline.tracking.pose_solver import DataTerm, position_term, reprojection_term
from pipeline.tracking.surface_model import SurfaceModel, SurfaceMotion, TemplatePoints, in_template, positions
from pipeline.tracking.surface_solver import ShapePrior, SurfaceProblem, shape_prior, solve_surface

LOG = logging.getLogger(__name__)

STEPS_PER_ROUND = 2
"""Gauss-Newton steps per round of a cue; then what it was linearised around is out of date."""


@dataclass(frozen=True)
class DeformationPrior:
    """Expectations of an unrigged template's offsets.

    Attributes:
        modes: number of waves of its surface they consist of; 0: it moves rigidly.
        offset_m: their typical size.
        length_m: distance on the surface over which they become independent.
        time_s: time over which they change.
        still_m: what moves less, in every frame, is taken for still.
    """

    modes: int
    offset_m: float
    length_m: float
    time_s: float
    still_m: float


def track_surface(
    template: Template, deformation: DeformationPrior, targets: KeypointTargets, observations: Observations,
    prior: MotionPrior, schedule: Sequence[Rounds], limits: TrackingLimits,
) -> Tracking:  # fmt: skip
    """Motion of consecutive frames; `schedule` may be empty.

    `prior` is of the root, and of the turns of rigid pieces, which are expected to move as joints do.

    Raises:
        InputError: if no frame has enough keypoints, or the template's unit is wrong.
    """
    rest, frames = template.vertices_rest[targets.vertices], observations.normalised.shape[1]
    observations, found = triangulate_unswapped(observations, targets.names, limits.inlier_px)
    measured = found.points.reshape(frames, -1, 3)
    solved = solvable_frames(np.isfinite(measured).all(-1).sum(1), limits)
    ratio = size_ratio(template, targets, measured, rest)
    basis = deformation_basis(
        template.vertices_rest, template.faces, deformation.modes, deformation.offset_m, deformation.length_m
    )
    model, kept = SurfaceModel(template, basis, rest.mean(0)), np.flatnonzero(solved)
    shape = shape_prior(basis, prior.at(kept), deformation.time_s)
    fit = _Fit(model, targets, observations.at(kept), prior.at(kept), shape, deformation.still_m)
    start, most = _aligned(model, rest, measured[kept]), limits.max_iterations
    motion = fit.near(start, measured[kept], deformation.offset_m, most)
    motion, sigma_px = fit.keypoints(motion, max(found.noise_px, SMALLEST_SIGMA_PX), most)
    for rounds in schedule:
        motion = fit.cues(motion, rounds.at(kept), sigma_px)
    motion = _filled(model, motion, kept, frames, prior.takes)
    named = positions(model.points(at_vertices(targets.vertices)), motion)
    return Tracking(
        pose=_root(motion),
        offsets=in_template(model.vertices(), motion) - template.vertices_rest,
        status=np.where(solved, "tracked", "interpolated"),
        residual_px=keypoint_residuals_px(observations, named),
        keypoints_m=measured,
        keypoint_sigma_m=found.sigma_m.reshape(frames, -1),
        noise_px=found.noise_px,
        sigma_px=sigma_px,
        size_ratio=ratio,
    )


@dataclass(frozen=True)
class _Fit:
    """The frames that are solved, and what every problem over them has in common."""

    model: SurfaceModel
    targets: KeypointTargets
    observations: Observations
    prior: MotionPrior
    shape_prior: ShapePrior
    still_m: float

    def solve(
        self, motion: SurfaceMotion, points: list[TemplatePoints], terms: list[DataTerm], sigma_px: float, steps: int,
        shape: ShapePrior,
    ) -> SurfaceMotion:  # fmt: skip
        some, named = self.observations, self.model.points(at_vertices(self.targets.vertices))
        seen = reprojection_term(some.cameras, some.normalised, some.confidence, sigma_px)
        return solve_surface(self._problem(shape, [named, *points], [seen, *terms]), motion, steps)

    def held(self, motion: SurfaceMotion) -> ShapePrior:
        """The prior, with what has not moved held still."""
        return self.shape_prior.held_still(self.model.basis, motion, self.still_m)

    def _problem(self, shape: ShapePrior, points: list[TemplatePoints], terms: list[DataTerm]) -> SurfaceProblem:
        none = np.full(len(self.targets.vertices), -1)
        root = tracked_points(self.model.template, none, self.targets.vertices)
        return SurfaceProblem(self.model, root, self.prior, shape, points, terms)

    def near(self, motion: SurfaceMotion, measured: np.ndarray, sigma_m: float, steps: int) -> SurfaceMotion:
        """Fit triangulated keypoints, trusted no further than offsets are large.

        An open mouth is not an outlier.
        """
        named = self.model.points(at_vertices(self.targets.vertices))
        term = position_term(measured, np.full(measured.shape[:2], sigma_m))
        return solve_surface(self._problem(self.shape_prior, [named], [term]), motion, steps)

    def keypoints(self, motion: SurfaceMotion, sigma_px: float, steps: int) -> tuple[SurfaceMotion, float]:
        """Fit the keypoints, twice.

        What the model cannot follow is noise to the second fit, and what never moves is held still in it.
        """
        named = self.model.points(at_vertices(self.targets.vertices))
        for held in (False, True):
            motion = self.solve(motion, [], [], sigma_px, steps, self.held(motion) if held else self.shape_prior)
            residual = keypoint_residuals_px(self.observations, positions(named, motion))
            sigma_px = max(float(np.nanmedian(residual)) / MEDIAN_OF_LENGTH, sigma_px)
        return motion, sigma_px

    def cues(self, motion: SurfaceMotion, rounds: Rounds, sigma_px: float) -> SurfaceMotion:
        """Linearise the cues around the mesh, fit, and again until it settles."""
        everything, cues = self.model.vertices(), rounds.cues
        for number in range(rounds.most):
            before = positions(everything, motion)
            terms = [cue.around(before) for cue in cues]
            points = [self.model.points(cue.points) for cue in cues]
            motion = self.solve(motion, points, terms, sigma_px, STEPS_PER_ROUND, self.held(motion))
            change = np.linalg.norm(positions(everything, motion) - before, axis=-1).mean()
            LOG.info("%s, round %d: vertices moved %.2f mm on average", rounds.name, number + 1, 1e3 * change)
            if change < SETTLED_M:
                break
        return motion


def _root(motion: SurfaceMotion) -> Pose:
    return Pose(motion.root_rotation, motion.root_translation, np.zeros((len(motion), 0, 4)))


def _aligned(
    model: SurfaceModel, rest: Float64[np.ndarray, "keypoints 3"], measured: Float64[np.ndarray, "frames keypoints 3"]
) -> SurfaceMotion:
    """The rest shape aligned rigidly to each frame.

    Frames whose points lie on a line start between the others.
    """
    rotations, translations, known = [], [], []
    for frame, points in enumerate(measured):
        use = np.isfinite(points).all(1)
        try:
            aligned = align_rigid(rest[use], points[use])
        except ValueError:
            continue
        rotations.append(quaternion_from_matrix(aligned.R))
        translations.append(aligned.t)
        known.append(frame)
    if not known:
        return model.rest(np.tile([1.0, 0.0, 0.0, 0.0], (len(measured), 1)), np.zeros((len(measured), 3)))
    return _filled(model, model.rest(np.array(rotations), np.array(translations)), np.array(known), len(measured), None)


def _filled(
    model: SurfaceModel, motion: SurfaceMotion, known: Int64[np.ndarray, " known"], frames: int,
    takes: Int64[np.ndarray, " frames"] | None,
) -> SurfaceMotion:  # fmt: skip
    """Motion of all `frames` from the `known` ones.

    The root is interpolated as in `fill_between`, turns and coefficients along lines.
    """
    root = fill_between(_root(motion), known, frames, model.pivot, takes)
    before, after, share = neighbours(known, frames, takes)
    weight = share[:, None, None]
    turns, coefficients = (
        values[before] * (1 - weight) + values[after] * weight for values in (motion.turns, motion.coefficients)
    )
    return SurfaceMotion(root.root_rotation, root.root_translation, turns, coefficients)
