"""Derivatives of kinematics and prior against differences, the banded solve against a dense one, planted poses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.geometry.kinematics import (
    Pose,
    TrackedPoints,
    derivatives_of,
    moved,
    point_positions,
    points_with_derivatives,
    tracked_points,
)
from pipeline.geometry.skin import Template, posed
from pipeline.geometry.surface_points import spread_points
from pipeline.geometry.template_file import read_template
from pipeline.tracking.mesh_tracker import fill_between
from pipeline.tracking.motion_prior import BandedSystem, MotionPrior, inverse_right_jacobian, prior_cost, prior_system
from pipeline.tracking.pose_equations import PointQuadratic, normal_equations, solve_equations
from pipeline.tracking.pose_solver import align_rigidly, position_term, reprojection_term, solve_poses
from tests.support.figures.walking import BONES, rest_joints, ring_of_cameras, walk, write_template

STEP = 1e-6
"""Of central differences: their error is about 1e-12 of truncation and 1e-10 of rounding."""


def wxyz(rotations: Rotation, *shape: int) -> np.ndarray:
    return np.roll(rotations.as_quat(), 1, axis=-1).reshape(*shape, 4)


@pytest.fixture
def template(tmp_path: Path) -> Template:
    return read_template(write_template(tmp_path / "t.glb", units_per_m=100.0), 0.01)


@pytest.fixture
def points(template: Template) -> TrackedPoints:
    """Every joint, and some vertices."""
    vertices = np.arange(0, len(template.vertices_rest), 50)
    joints = np.concatenate([np.arange(len(BONES)), np.full(len(vertices), -1)])
    return tracked_points(template, joints, np.concatenate([np.full(len(BONES), -1), vertices]))


def random_pose(frames: int, seed: int = 0, size: float = 0.5) -> Pose:
    rng = np.random.default_rng(seed)
    joints = Rotation.from_rotvec(size * rng.normal(size=(frames * len(BONES), 3)))
    joint_rotations = wxyz(joints, frames, len(BONES))
    joint_rotations[:, 0] = [1.0, 0.0, 0.0, 0.0]
    root = Rotation.from_rotvec(size * rng.normal(size=(frames, 3)))
    return Pose(wxyz(root, frames), rng.normal(size=(frames, 3)), joint_rotations)


def test_tracked_points_are_the_posed_vertices(template: Template, points: TrackedPoints) -> None:
    pose = random_pose(3)
    vertices = posed(template, pose.root_rotation, pose.root_translation, pose.joint_rotations)
    positions = point_positions(points, pose)
    assert np.abs(positions[:, len(BONES) :] - vertices[:, ::50]).max() < 1e-12
    assert np.abs(point_positions(points, points.rest_pose(1))[0, : len(BONES)] - rest_joints()).max() < 1e-6


def test_derivatives_of_points_match_differences(points: TrackedPoints) -> None:
    pose = random_pose(2, seed=1)
    positions, derivatives = points_with_derivatives(points, pose)
    assert np.abs(positions - point_positions(points, pose)).max() < 1e-12
    for unknown in range(points.unknowns):
        step = np.zeros((2, points.unknowns))
        step[:, unknown] = STEP
        ahead, behind = (point_positions(points, moved(points, pose, s)) for s in (step, -step))
        assert np.abs(derivatives[..., unknown] - (ahead - behind) / (2 * STEP)).max() < 1e-8


def test_fast_derivatives_are_those_of_the_slow_twin(template: Template, points: TrackedPoints) -> None:
    pose = random_pose(3, seed=7)
    for these in (points, points.with_surface(spread_points(template.vertices_rest, template.faces, 40))):
        wanted = np.random.default_rng(7).random((3, len(these.parts))) < 0.6
        _, slow = points_with_derivatives(these, pose)
        for frame, (some, fast) in enumerate(derivatives_of(these, pose, wanted)):
            assert (some == np.flatnonzero(wanted[frame])).all()
            assert np.abs(fast - slow[frame, some]).max() < 1e-13


def test_equations_of_coupled_frames_are_those_of_all_unknowns(points: TrackedPoints) -> None:
    pose, prior, random = random_pose(3, seed=8), uneven_prior(3), np.random.default_rng(8)
    root = random.normal(size=(3, len(points.parts), 3, 4))
    normal = root @ root.swapaxes(2, 3)
    shared = 0.3 * random.normal(size=(3, len(points.parts), 3, 2))
    gradient = random.normal(size=(3, len(points.parts), 3))
    normal[1, ::2], gradient[1, ::2], shared[1, ::2] = 0.0, 0.0, 0.0
    shared[:, 5] = 0.0
    _, slow = points_with_derivatives(points, pose)
    expected, slope = dense(points, prior, pose)
    n = points.unknowns
    for f in range(3):
        own = slice(f * n, (f + 1) * n)
        expected[own, own] += np.einsum("pau,pab,pbv->uv", slow[f], normal[f], slow[f])
        slope[own] += np.einsum("pa,pau->u", gradient[f], slow[f])
        for g in range(3):
            coupling = np.einsum("pau,pak,pbk,pbv->uv", slow[f], shared[f], shared[g], slow[g], optimize=True)
            expected[own, g * n : (g + 1) * n] -= coupling
    system = normal_equations(points, PointQuadratic(0.0, gradient, normal, shared), prior, pose)
    assert np.allclose(np.tril(system.lower), np.tril(expected), rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    assert np.allclose(system.gradient.ravel(), slope, rtol=1e-9, atol=1e-9 * np.abs(slope).max())


def test_scaled_joints_have_exact_derivatives_too(points: TrackedPoints) -> None:
    after = points.template.after.copy()
    after[:, :3, :3] = np.diag([1.3, 0.7, 1.1])
    scaled = replace(points, template=replace(points.template, after=after))
    test_derivatives_of_points_match_differences(scaled)


@pytest.mark.parametrize("angle", [0.0, 1e-6, 0.9e-2, 1.1e-2, 1.0, 3.0])
def test_inverse_right_jacobian_is_the_slope_of_the_logarithm(angle: float) -> None:
    vector = angle * np.array([2.0, -1.0, 2.0]) / 3
    jacobian, here = inverse_right_jacobian(vector), Rotation.from_rotvec(vector)
    for axis in range(3):
        turn = Rotation.from_rotvec(STEP * np.eye(3)[axis])
        slope = ((here * turn).as_rotvec() - (here * turn.inv()).as_rotvec()) / (2 * STEP)
        assert np.abs(jacobian[:, axis] - slope).max() < 1e-8


def uneven_prior(frames: int) -> MotionPrior:
    return MotionPrior(np.cumsum(np.r_[0.0, np.tile([0.04, 0.1, 0.05], frames)])[:frames], 20.0, 5.0, 0.7)


def dense(points: TrackedPoints, prior: MotionPrior, pose: Pose) -> tuple[np.ndarray, np.ndarray]:
    system, n = prior_system(prior, points, pose), points.unknowns
    matrix = np.zeros((len(pose) * n, len(pose) * n))
    for apart, blocks in enumerate((system.diagonal, system.first, system.second)):
        for f in range(len(pose) - apart):
            rows, columns = slice((f + apart) * n, (f + apart + 1) * n), slice(f * n, (f + 1) * n)
            matrix[rows, columns] = blocks[f]
            matrix[columns, rows] = blocks[f].T
    return matrix, system.gradient.ravel()


@pytest.mark.parametrize("hinges", [None, np.eye(len(BONES))[:, :3]], ids=["free", "hinges"])
def test_gradient_of_the_prior_matches_differences(points: TrackedPoints, hinges: np.ndarray | None) -> None:
    prior, pose = replace(uneven_prior(5), hinges=hinges), random_pose(5, seed=2, size=0.3)
    _, gradient = dense(points, prior, pose)
    rng = np.random.default_rng(0)
    for _ in range(20):
        step = rng.normal(size=(5, points.unknowns))
        ahead, behind = (prior_cost(prior, points, moved(points, pose, s * STEP * step)) for s in (1, -1))
        assert gradient @ step.ravel() == pytest.approx((ahead - behind) / (2 * STEP), rel=1e-5)


def test_steady_motion_has_no_acceleration_at_uneven_times(points: TrackedPoints) -> None:
    prior = uneven_prior(6)
    turn = Rotation.from_rotvec(np.outer(prior.times_s, [0.3, -0.8, 0.5]))
    pose = points.rest_pose(6)
    pivot = np.outer(prior.times_s, [1.0, 2.0, 0.5])
    pose = Pose(wxyz(turn, 6), pivot - turn.apply(points.pivot), pose.joint_rotations)
    assert prior_cost(prior, points, pose) < 1e-16


def test_banded_solve_equals_a_dense_one(points: TrackedPoints) -> None:
    prior, pose = uneven_prior(6), random_pose(6, seed=3, size=0.3)
    matrix, gradient = dense(points, prior, pose)
    damping = 0.1
    matrix[np.diag_indices_from(matrix)] *= 1 + damping
    expected = np.linalg.solve(matrix, -gradient)
    step = solve_equations(prior_system(prior, points, pose), damping)
    assert np.allclose(step.ravel(), expected, rtol=1e-7, atol=1e-9)


def test_a_lone_frame_is_solved_and_its_system_left_as_it_was() -> None:
    random = np.random.default_rng(9)
    root, gradient, nothing = random.normal(size=(5, 5)), random.normal(size=(1, 5)), np.zeros((1, 5, 5))
    system = BandedSystem((root @ root.T)[None], nothing, nothing, gradient)
    expected = np.linalg.solve(root @ root.T + 0.1 * np.diag(np.diag(root @ root.T)), -gradient[0])
    for _ in range(2):
        assert np.allclose(solve_equations(system, 0.1)[0], expected)


def test_planted_poses_are_recovered_from_exact_keypoints(points: TrackedPoints) -> None:
    truth, cameras = random_pose(3, seed=4, size=0.3), list(ring_of_cameras(5).values())
    truth = Pose(truth.root_rotation, 0.1 * truth.root_translation, truth.joint_rotations)
    weak = MotionPrior(np.arange(3) / 24, 1e6, 1e6, 1e6)
    where = point_positions(points, truth)
    start, _ = solve_poses(points, position_term(where, np.full(where.shape[:2], 0.01)), weak, points.rest_pose(3), 50)
    assert np.abs(point_positions(points, start) - where).max() < 1e-5
    observed = np.stack([c.undistort(c.project(where)[0].reshape(-1, 2)).reshape(*where.shape[:2], 2) for c in cameras])
    observed[0, :, :3] += 0.1  # one camera is wrong about three points: by 100 pixels
    term = reprojection_term(cameras, observed, np.ones(observed.shape[:3]), 0.5)
    pose, _ = solve_poses(points, term, weak, start, 50)
    assert np.abs(point_positions(points, pose) - where).max() < 1e-3


def test_alignment_recovers_a_planted_transform_and_never_mirrors() -> None:
    rng = np.random.default_rng(6)
    turn, shift = Rotation.random(rng=rng), rng.normal(size=3)
    for source in (rng.normal(size=(7, 3)), rng.normal(size=(7, 3)) * [1, 1, 0]):
        rotation, translation = align_rigidly(source, turn.apply(source) + shift, rng.uniform(0.5, 2, 7))
        assert np.abs(np.abs(rotation @ wxyz(turn)) - 1).max() < 1e-12
        assert np.abs(translation - shift).max() < 1e-12


def test_mirrored_points_are_turned_and_not_mirrored() -> None:
    """Noise has flipped a nearly flat figure: the best orthogonal matrix is a mirror, the best rotation is not."""
    rng = np.random.default_rng(6)
    turn = Rotation.random(rng=rng)
    source = rng.normal(size=(20, 3)) * [1, 1, 0.01]
    rotation, _ = align_rigidly(source, turn.apply(source * [1, 1, -1]), np.ones(20))
    off = Rotation.from_quat(np.roll(rotation, -1)) * turn.inv()
    assert np.linalg.norm(rotation) == pytest.approx(1)
    assert off.magnitude() < 0.02


def test_gaps_are_filled_on_the_manifold_and_ends_are_held() -> None:
    known, pivot = np.array([1, 3, 4]), np.array([1.0, 2.0, 3.0])
    turn = Rotation.from_rotvec(np.outer([1.0, 3.0, 3.5], [0.0, 0.6, 0.8]))
    pose = Pose(wxyz(turn, 3), np.outer([1.0, 3.0, 5.0], [1, 1, 0]) - turn.apply(pivot), wxyz(turn, 3, 1))
    filled = fill_between(pose, known, 6, pivot)
    turned = Rotation.from_quat(np.roll(filled.joint_rotations[:, 0], -1, axis=-1)).as_rotvec() @ [0.0, 0.6, 0.8]
    assert np.allclose((turned - [1, 1, 2, 3, 3.5, 3.5] + np.pi) % (2 * np.pi) - np.pi, 0, atol=1e-12)
    moved_pivot = Rotation.from_quat(np.roll(filled.root_rotation, -1, axis=-1)).apply(pivot) + filled.root_translation
    assert np.allclose(moved_pivot, np.outer([1, 1, 2, 3, 5, 5], [1, 1, 0]), atol=1e-12)


def test_a_whole_motion_is_followed_from_its_joints(template: Template) -> None:
    motion = walk(10)
    points = tracked_points(template, np.arange(len(BONES)), np.full(len(BONES), -1))
    prior = MotionPrior(motion.times_s, 30.0, 10.0, 1.0)
    term = position_term(motion.joints, np.full(motion.joints.shape[:2], 1e-3))
    pose, _ = solve_poses(points, term, prior, points.rest_pose(10), 60)
    assert np.linalg.norm(point_positions(points, pose) - motion.joints, axis=-1).max() < 1e-3
