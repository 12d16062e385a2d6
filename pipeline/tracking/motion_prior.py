"""The prior on motion: small accelerations, and local rotations near the rest pose.

The twist of a round limb is seen by no keypoint and no silhouette: there it is the rest pose that decides, and hinges
where they are known. The rest pose's loss is Cauchy's, because a joint far from rest says nothing about its twist; the
frames in which it is near say it for all.

Rotations are differenced on the manifold: the velocity between two frames is log(R_f^T R_{f+1}) / dt, and its
derivatives are the inverse Jacobians of the exponential map (Sola et al. 2018, "A micro Lie theory", eqs. 143-146).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from pipeline.geometry.kinematics import Pose, TrackedPoints
from pipeline.geometry.least_squares import cauchy
from pipeline.geometry.rotations import (
    conjugate_quaternion,
    matrix_from_quaternion,
    multiply_quaternions,
    rotation_vector_from_quaternion,
    skew,
)

DECORRELATION_S = 1 / 24
"""Time over which accelerations count as independent. Costs are integrals over time divided by it, so that a capture
at 90 frames per second is not smoothed more than one at 24."""

HINGE_PLAY_RAD = 0.1
"""Standard deviation of what a hinge turns about other axes, or backwards: 6 degrees. Half or twice as much moves what
95 % of subjectA's vertices stay within, 7.2 mm, by 0.3 mm."""

SERIES_BELOW_RAD = 1e-2
"""Angle below which the coefficient in `inverse_right_jacobian` is taken from its series; the error is below 1e-12."""


@dataclass(frozen=True)
class MotionPrior:
    """Standard deviations of what the prior expects.

    Attributes:
        times_s: time of each frame, increasing.
        rotation_acceleration: of every local rotation and the root's [rad/s^2].
        translation_acceleration: of the root's pivot [m/s^2].
        rest_rotation: of every local rotation from its rest [rad]; its tails are heavy, as Cauchy's.
        expected: local rotations to expect in each frame instead of the rest pose's.
        hinges: axis, of length one, that a joint bends about from its rest, in the joint's frame, one way; 0 where it
            is free.
        takes: number of the take that each frame belongs to: across a cut, no motion is expected at all. None: one.
    """

    times_s: Float64[np.ndarray, " frames"]
    rotation_acceleration: float
    translation_acceleration: float
    rest_rotation: float
    expected: Float64[np.ndarray, "frames joints 4"] | None = None
    hinges: Float64[np.ndarray, "joints 3"] | None = None
    takes: Int64[np.ndarray, " frames"] | None = None

    def at(self, frames: np.ndarray) -> MotionPrior:
        """The prior of some of the frames."""
        expected, takes = (None if a is None else a[frames] for a in (self.expected, self.takes))
        return replace(self, times_s=self.times_s[frames], expected=expected, takes=takes)


@dataclass(frozen=True)
class BandedSystem:
    """Normal equations of a chain of frames, in which a frame is coupled to the next two.

    Blocks are `diagonal` H[f, f], `first` H[f + 1, f] and `second` H[f + 2, f].
    """

    diagonal: Float64[np.ndarray, "frames unknowns unknowns"]
    first: Float64[np.ndarray, "frames unknowns unknowns"]
    second: Float64[np.ndarray, "frames unknowns unknowns"]
    gradient: Float64[np.ndarray, "frames unknowns"]


def inverse_right_jacobian(vector: Float64[np.ndarray, "*batch 3"]) -> Float64[np.ndarray, "*batch 3 3"]:
    """J with log(exp(v) exp(d)) = v + J d for small d; its transpose is the left one. For angles up to pi."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    safe = np.where(angle < SERIES_BELOW_RAD, 1.0, angle)
    exact = (1 - 0.5 * safe / np.tan(0.5 * safe)) / safe**2
    coefficient = np.where(angle < SERIES_BELOW_RAD, 1 / 12 + angle**2 / 720, exact)
    cross = skew(vector)
    return np.eye(3) + 0.5 * cross + coefficient * cross @ cross


def _states(points: TrackedPoints, pose: Pose) -> tuple[np.ndarray, np.ndarray]:
    """Pivot in the world [F, 3] and solved rotations [F, 1 + free, 4], ordered as unknowns."""
    pivot = matrix_from_quaternion(pose.root_rotation) @ points.pivot + pose.root_translation
    return pivot, np.concatenate([pose.root_rotation[:, None], pose.joint_rotations[:, points.free]], 1)


def _accelerations(prior: MotionPrior, points: TrackedPoints, pose: Pose) -> tuple[np.ndarray, ...]:
    """Whitened accelerations, velocities, time steps and scales.

    Shapes are [F - 2, parts, 3], [F - 1, parts, 3], [F - 1] and [F - 2, parts].
    """
    pivot, rotations = _states(points, pose)
    dt = np.diff(prior.times_s)
    turned = rotation_vector_from_quaternion(multiply_quaternions(conjugate_quaternion(rotations[:-1]), rotations[1:]))
    change = np.concatenate([np.diff(pivot, axis=0)[:, None], turned], 1)
    between = 0.5 * (dt[1:] + dt[:-1])
    sigma = np.full(change.shape[1], prior.rotation_acceleration)
    sigma[0] = prior.translation_acceleration
    scale = np.sqrt(between / DECORRELATION_S)[:, None] / between[:, None] / sigma
    if prior.takes is not None:
        scale[(prior.takes[2:] != prior.takes[1:-1]) | (prior.takes[1:-1] != prior.takes[:-2])] = 0.0
    velocity = change / dt[:, None, None]
    return np.diff(velocity, axis=0) * scale[..., None], change, dt, scale


def _share(prior: MotionPrior, pose: Pose) -> float:
    """What a frame counts: the time it stands for, in `DECORRELATION_S`.

    It is the median, since a frame beside a gap or a cut says no more about its pose than any other.
    """
    return float(np.median(np.diff(prior.times_s)) / DECORRELATION_S) if len(pose) > 1 else 1.0


def _from_rest(prior: MotionPrior, points: TrackedPoints, pose: Pose) -> tuple[np.ndarray, np.ndarray, float]:
    """Rotation vectors from rest [F, free, 3], robust precision [F, free, 3, 3], and half their cost."""
    rest = points.template.rest_rotations[None] if prior.expected is None else prior.expected
    away = rotation_vector_from_quaternion(
        multiply_quaternions(conjugate_quaternion(rest[:, points.free]), pose.joint_rotations[:, points.free])
    )
    share = _share(prior, pose)
    losses, weight = cauchy((away**2).sum(-1) / prior.rest_rotation**2)
    precision = (share * weight / prior.rest_rotation**2)[..., None, None] * np.eye(3)
    return away, precision, float((share * losses).sum())


def _off_hinges(prior: MotionPrior, points: TrackedPoints, pose: Pose) -> tuple[np.ndarray, np.ndarray, float]:
    """Rotation vectors from the rest pose, and precision and half the cost of what no hinge allows, as `_from_rest`.

    That is a turn about another axis, and bending backwards.
    """
    axis = prior.hinges[points.free]
    rest = conjugate_quaternion(points.template.rest_rotations[points.free])
    turned = rotation_vector_from_quaternion(multiply_quaternions(rest[None], pose.joint_rotations[:, points.free]))
    along = axis[:, :, None] * axis[:, None, :]
    is_hinge = (axis != 0).any(-1)[:, None, None]
    backwards = ((turned * axis).sum(-1) < 0)[..., None, None]
    stiff = np.where(is_hinge, np.eye(3) - along, 0.0) + np.where(backwards, along, 0.0)
    precision = _share(prior, pose) / HINGE_PLAY_RAD**2 * stiff
    return turned, precision, 0.5 * float(np.einsum("fpa,fpab,fpb->", turned, precision, turned))


def _turns(prior: MotionPrior, points: TrackedPoints, pose: Pose) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """What is expected of single frames' local rotations: `_from_rest`, and `_off_hinges` if there are any."""
    terms = [_from_rest(prior, points, pose)]
    return terms if prior.hinges is None else [*terms, _off_hinges(prior, points, pose)]


def prior_cost(prior: MotionPrior, points: TrackedPoints, pose: Pose) -> float:
    """Cost of a motion: accelerations, distance from rest, and turns that no hinge allows.

    Half the squares of whitened ones; of the distance from rest, Cauchy's loss.
    """
    cost = sum(cost for _, _, cost in _turns(prior, points, pose))
    if len(pose) > 2:
        cost += 0.5 * (_accelerations(prior, points, pose)[0] ** 2).sum()
    return float(cost)


def prior_system(prior: MotionPrior, points: TrackedPoints, pose: Pose) -> BandedSystem:
    """Gauss-Newton normal equations of `prior_cost`."""
    frames, unknowns = len(pose), points.unknowns
    parts = unknowns // 3
    blocks = [np.zeros((frames, parts, 3, 3)) for _ in range(3)]
    gradient = np.zeros((frames, parts, 3))
    for away, precision, _ in _turns(prior, points, pose):
        jacobian = inverse_right_jacobian(away)
        carried = (precision @ jacobian).swapaxes(-1, -2)
        blocks[0][:, 2:] += carried @ jacobian
        gradient[:, 2:] += (carried @ away[..., None])[..., 0]
    if frames > 2:
        residual, change, dt, scale = _accelerations(prior, points, pose)
        onward = inverse_right_jacobian(change)
        onward[:, 0] = np.eye(3)
        back = -onward.swapaxes(-1, -2)
        onward, back = onward / dt[:, None, None, None], back / dt[:, None, None, None]
        s = scale[..., None, None]
        by_frame = [-s * back[:-1], s * (back[1:] - onward[:-1]), s * onward[1:]]
        for a in range(3):
            rows = slice(a, a + frames - 2)
            gradient[rows] += np.einsum("fpia,fpi->fpa", by_frame[a], residual)
            for b in range(a + 1):
                blocks[a - b][b : b + frames - 2] += by_frame[a].swapaxes(-1, -2) @ by_frame[b]
    dense = [np.zeros((frames, parts, 3, parts, 3)) for _ in range(3)]
    index = np.arange(parts)
    for whole, block in zip(dense, blocks, strict=True):
        whole[:, index, :, index, :] = block.swapaxes(0, 1)
    full = [whole.reshape(frames, unknowns, unknowns) for whole in dense]
    return BandedSystem(full[0], full[1], full[2], gradient.reshape(frames, unknowns))
