"""Motion of an unrigged template in all frames of a chunk: one least-squares problem.

Levenberg-Marquardt like `pipeline.tracking.pose_solver`, with hundreds of unknowns per frame: the frames' blocks are
factorised one by one and precondition conjugate gradients, which care for what couples the frames.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse.linalg
from jaxtyping import Float64, Int64

from pipeline.geometry.kinematics import Pose, TrackedPoints
from pipeline.tracking.block_factor import BlockFactor
from pipeline.tracking.deformation_basis import DeformationBasis
from pipeline.tracking.motion_prior import DECORRELATION_S, BandedSystem, MotionPrior, prior_cost, prior_system
from pipeline.tracking.pose_solver import CONVERGED, LEAST_DAMPING, MOST_DAMPING, START_DAMPING, DataTerm
from pipeline.tracking.surface_model import SurfaceModel, SurfaceMotion, TemplatePoints, normal_equations, positions

STEP_TOLERANCE = 1e-2
"""Relative residual at which a step is good enough: the next linearisation changes it by more."""

MOST_STEP_ITERATIONS = 60
"""Of conjugate gradients; smoothness in time couples neighbours weakly, ten are usual."""


@dataclass(frozen=True)
class ShapePrior:
    """Gaussian priors of the unknowns in `SurfaceMotion.shape` and of their accelerations.

    All have mean zero and are independent.
    Attributes:
        sigma: standard deviation of each unknown (radians, then metres).
        acceleration: standard deviation of its acceleration.
        times_s: of each frame, increasing.
        takes: number of the take that each frame belongs to: across a cut, accelerations are free.
        still: precision of the coefficients, the same for each axis, that holds what does not move (`held_still`).
    """

    sigma: Float64[np.ndarray, " shape_unknowns"]
    acceleration: Float64[np.ndarray, " shape_unknowns"]
    times_s: Float64[np.ndarray, " frames"]
    takes: Int64[np.ndarray, " frames"]
    still: Float64[np.ndarray, "modes modes"]

    def at(self, frames: np.ndarray) -> ShapePrior:
        """The prior of some of the frames."""
        return replace(self, times_s=self.times_s[frames], takes=self.takes[frames])

    def held_still(self, basis: DeformationBasis, motion: SurfaceMotion, still_m: float) -> ShapePrior:
        """The prior that holds what never moves as far as `still_m`: skull and ears, but no cheek.

        The weights, around `motion`, of Geman and McClure's loss (1987) m / (1 + m), m being a vertex's largest mean
        square offset in any frame, by `still_m`^2: it lets go of what moves for sure. The prior in `sigma` alone would
        expect as much motion of a skull as of a mouth.
        """
        count = motion.coefficients.shape[1]
        if not count:
            return self
        flat = basis.modes @ motion.coefficients.transpose(1, 0, 2).reshape(count, -1)
        square = (flat.reshape(len(flat), -1, 3) ** 2).mean(2).max(1)
        weight = basis.weight / still_m**2 / (1 + square / still_m**2) ** 2
        return replace(self, still=basis.modes.T @ (weight[:, None] * basis.modes))

    def weights(self) -> tuple[np.ndarray, np.ndarray]:
        """Weight of `sigma` in each frame [F], and cost of accelerations [F, F] of deviation 1."""
        times, count = self.times_s, len(self.times_s)
        spacing = np.gradient(times) if count > 1 else np.full(1, DECORRELATION_S)
        second = np.zeros((max(count - 2, 0), count))
        for row in np.flatnonzero(self.takes[2:] == self.takes[: max(count - 2, 0)]):
            before, after = times[row + 1] - times[row], times[row + 2] - times[row + 1]
            between = 0.5 * (before + after)
            second[row, row : row + 3] = np.array([1 / before, -1 / before - 1 / after, 1 / after]) / between
            second[row] *= np.sqrt(between / DECORRELATION_S)
        return spacing / DECORRELATION_S, second.T @ second


@dataclass(frozen=True)
class SurfaceProblem:
    """The least-squares problem: a model, its priors, and points with their data terms.

    Attributes:
        root: the root as `pipeline.tracking.motion_prior` knows it: a template without joints.
        root_prior, shape_prior: of the root, and of turns and offsets.
        points, terms: groups of points, each with the data term that sees it.
    """

    model: SurfaceModel
    root: TrackedPoints
    root_prior: MotionPrior
    shape_prior: ShapePrior
    points: Sequence[TemplatePoints]
    terms: Sequence[DataTerm]

    def cost(self, motion: SurfaceMotion) -> float:
        """Data and priors."""
        data = sum(t(positions(p, motion)).cost for p, t in zip(self.points, self.terms, strict=True))
        rest, bending = self.shape_prior.weights()
        shape = motion.shape
        still = 0.5 * (rest[:, None] * (shape / self.shape_prior.sigma) ** 2).sum()
        pull = np.einsum("kl,fla->fka", self.shape_prior.still, motion.coefficients, optimize=True)
        still += 0.5 * np.einsum("f,fka,fka->", rest, motion.coefficients, pull, optimize=True)
        calm = (
            0.5 * ((shape / self.shape_prior.acceleration) * (bending @ (shape / self.shape_prior.acceleration))).sum()
        )
        return float(data + still + calm + prior_cost(self.root_prior, self.root, _pose(motion)))


def solve_surface(problem: SurfaceProblem, start: SurfaceMotion, iterations: int) -> SurfaceMotion:
    """The motion that minimises the cost, from `start`."""
    motion, damping, cost = start, START_DAMPING, problem.cost(start)
    for _ in range(iterations):
        system = _System(problem, motion)
        while damping <= MOST_DAMPING:
            candidate = problem.model.moved(motion, system.step(damping))
            new_cost = problem.cost(candidate)
            if new_cost < cost:
                break
            damping *= 10
        else:
            return motion
        decrease, motion, cost = cost - new_cost, candidate, new_cost
        damping = max(damping / 10, LEAST_DAMPING)
        if decrease < CONVERGED * cost:
            break
    return motion


def shape_prior(basis: DeformationBasis, prior: MotionPrior, deformation_time_s: float) -> ShapePrior:
    """The prior of a basis: rigid pieces turn as joints do, offsets change over a given time."""
    count, modes = 3 * len(basis.centers), np.repeat(basis.sigma_m, 3)
    return ShapePrior(
        np.concatenate([np.full(count, prior.rest_rotation), modes]),
        np.concatenate([np.full(count, prior.rotation_acceleration), modes / deformation_time_s**2]),
        prior.times_s,
        np.zeros(len(prior.times_s), np.int64) if prior.takes is None else prior.takes,
        np.zeros((len(basis.sigma_m),) * 2),
    )


def _pose(motion: SurfaceMotion) -> Pose:
    return Pose(motion.root_rotation, motion.root_translation, np.zeros((len(motion), 0, 4)))


class _System:
    """Gauss-Newton equations around a motion: dense within frames, banded or nearly so between."""

    def __init__(self, problem: SurfaceProblem, motion: SurfaceMotion) -> None:
        prior, shape = problem.shape_prior, motion.shape
        self.root = prior_system(problem.root_prior, problem.root, _pose(motion))
        rest, self.bending = prior.weights()
        self.calm = 1 / prior.acceleration**2
        self.blocks, self.gradient = _summed(problem, motion)
        self.gradient[:, :6] += self.root.gradient
        self.gradient[:, 6:] += rest[:, None] * shape / prior.sigma**2 + self.calm * (self.bending @ shape)
        diagonal = np.einsum("fii->fi", self.blocks)
        diagonal[:, 6:] += rest[:, None] / prior.sigma**2
        few = self.gradient.shape[1] - motion.coefficients[0].size
        pull = np.einsum("kl,fla->fka", prior.still, motion.coefficients, optimize=True)
        self.gradient[:, few:] += rest[:, None] * pull.reshape(len(motion), -1)
        for axis in range(3):
            self.blocks[:, few + axis :: 3, few + axis :: 3] += rest[:, None, None] * prior.still

    def step(self, damping: float) -> Float64[np.ndarray, "frames unknowns"]:
        """-(H + damping diag H)^-1 gradient."""
        frames, count = self.gradient.shape
        own = self.blocks.copy()
        own[:, :6, :6] += self.root.diagonal
        diagonal = np.einsum("fii->fi", own)
        diagonal[:, 6:] += np.diag(self.bending)[:, None] * self.calm
        extra = damping * np.where(diagonal > 0, diagonal, 1.0)
        diagonal += extra
        factors = [BlockFactor.of(block) for block in own]

        def precondition(flat: np.ndarray) -> np.ndarray:
            rows = flat.reshape(frames, count)
            return np.concatenate([factor.solve(row) for factor, row in zip(factors, rows, strict=True)])

        def apply(flat: np.ndarray) -> np.ndarray:
            x = flat.reshape(frames, count)
            result = (self.blocks @ x[..., None])[..., 0] + extra * x
            result[:, 6:] += self.calm * (self.bending @ x[:, 6:])
            result[:, :6] += _banded_product(self.root, x[:, :6])
            return result.ravel()

        def operator(function: Callable[[np.ndarray], np.ndarray]) -> scipy.sparse.linalg.LinearOperator:
            return scipy.sparse.linalg.LinearOperator((frames * count,) * 2, function, dtype=np.float64)

        solution, _ = scipy.sparse.linalg.cg(
            operator(apply), -self.gradient.ravel(), rtol=STEP_TOLERANCE, maxiter=MOST_STEP_ITERATIONS,
            M=operator(precondition),
        )  # fmt: skip
        return solution.reshape(frames, count)


def _summed(problem: SurfaceProblem, motion: SurfaceMotion) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations of all data, summed in place: those of hundreds of unknowns are a hundred megabytes."""
    blocks, gradient = None, None
    for points, term in zip(problem.points, problem.terms, strict=True):
        more = normal_equations(problem.model, points, motion, term(positions(points, motion)))
        if blocks is None:
            blocks, gradient = more
        else:
            blocks += more[0]
            gradient += more[1]
    return blocks, gradient


def _banded_product(system: BandedSystem, x: Float64[np.ndarray, "frames 6"]) -> Float64[np.ndarray, "frames 6"]:
    result = (system.diagonal @ x[..., None])[..., 0]
    for apart, blocks in ((1, system.first), (2, system.second)):
        below = blocks[: max(len(x) - apart, 0)]
        result[apart:] += (below @ x[:-apart, :, None])[..., 0]
        result[:-apart] += (below.swapaxes(1, 2) @ x[apart:, :, None])[..., 0]
    return result
