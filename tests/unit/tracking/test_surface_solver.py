"""An unrigged template in motion: derivatives against differences, planted motion recovered, gaps in time filled."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from pipeline.geometry.kinematics import tracked_points
from pipeline.geometry.skin import Template
from pipeline.geometry.surface_points import at_vertices
from pipeline.tracking.deformation_basis import deformation_basis
from pipeline.tracking.motion_prior import MotionPrior
from pipeline.tracking.pose_equations import PointQuadratic
from pipeline.tracking.pose_solver import position_term
from pipeline.tracking.surface_model import SurfaceModel, SurfaceMotion, normal_equations, positions
from pipeline.tracking.surface_solver import SurfaceProblem, shape_prior, solve_surface

FPS = 15.0


def unrigged(vertices, faces):
    none = np.zeros((0, 4, 4))
    integers = np.zeros(0, np.int64)
    return Template(
        vertices_rest=vertices, faces=faces, uv=None, joint_nodes=integers, parents=integers, before=none, after=none,
        rest_rotations=np.zeros((0, 4)), inverse_bind=none, weights=np.zeros((len(vertices), 0)),
        vertices_bind=vertices, scale_to_m=1.0,
    )  # fmt: skip


@pytest.fixture(scope="module")
def model():
    """An egg of 0.2 m with one eye."""
    egg = trimesh.creation.icosphere(3, 0.1)
    eye = trimesh.creation.icosphere(1, 0.012)
    vertices = np.concatenate([egg.vertices * [0.8, 1.2, 0.9], eye.vertices + np.array([0.03, 0.01, 0.085])])
    faces = np.concatenate([egg.faces, eye.faces + len(egg.vertices)]).astype(np.int64)
    template = unrigged(vertices.astype(np.float64), faces)
    return SurfaceModel(
        template, deformation_basis(template.vertices_rest, faces, 40, 0.003, 0.03), np.array([0, 0.02, 0])
    )


def some_motion(model, frames, seed=0):
    random = np.random.default_rng(seed)
    turns = Rotation.from_rotvec(0.3 * random.normal(size=(frames, 3))).as_quat(scalar_first=True)
    return SurfaceMotion(
        turns, 0.1 * random.normal(size=(frames, 3)), 0.3 * random.normal(size=(frames, model.parts, 3)),
        0.002 * random.normal(size=(frames, model.basis.modes.shape[1], 3)),
    )  # fmt: skip


def problem(model, terms, points, times, takes=None):
    prior = MotionPrior(times, 30.0, 10.0, 0.3, takes=takes)
    chosen = np.arange(0, len(model.template.vertices_rest), 30)
    root = tracked_points(model.template, np.full(len(chosen), -1), chosen)
    return SurfaceProblem(model, root, prior, shape_prior(model.basis, prior, 0.1), points, terms)


def test_positions_are_the_formula_of_the_module(model):
    motion = some_motion(model, 2)
    found = positions(model.vertices(), motion)
    rest, eye = model.template.vertices_rest, model.basis.part == 0
    for f in range(2):
        shape = rest + model.basis.modes @ motion.coefficients[f]
        center = model.basis.centers[0]
        shape[eye] = Rotation.from_rotvec(motion.turns[f, 0]).apply(rest[eye] - center) + center
        root = Rotation.from_quat(motion.root_rotation[f], scalar_first=True)
        np.testing.assert_allclose(found[f], root.apply(shape) + motion.root_translation[f], atol=1e-12)


def test_system_is_the_derivative_by_every_unknown(model):
    """Against central differences of a linear function of positions, and the normal matrix against J^T N J."""
    random, motion, points = np.random.default_rng(1), some_motion(model, 1), model.vertices()
    shape = positions(points, motion).shape
    gradient, root = random.normal(size=shape), random.normal(size=(*shape, 3))
    normal = root @ root.swapaxes(-1, -2)
    matrix, found = normal_equations(model, points, motion, PointQuadratic(0.0, gradient, normal))
    step, columns = 1e-6, []
    for unknown in range(found.shape[1]):
        change = np.zeros_like(found)
        change[0, unknown] = step
        ahead, back = (positions(points, model.moved(motion, sign * change)) for sign in (1, -1))
        columns.append((ahead - back) / (2 * step))
    jacobian = np.stack(columns, -1)
    np.testing.assert_allclose(found[0], np.einsum("fpa,fpan->n", gradient, jacobian), rtol=1e-5, atol=1e-6)
    expected = np.einsum("fpam,fpab,fpbn->mn", jacobian, normal, jacobian, optimize=True)
    np.testing.assert_allclose(matrix[0], expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())


def test_planted_motion_is_recovered(model):
    """A smooth bump that is no mode, an eye that turns, a root 40 degrees from where the search begins."""
    frames = 5
    times = np.arange(frames) / FPS
    rest, eye = model.template.vertices_rest, model.basis.part == 0
    fall = np.exp(-0.5 * ((rest - [0, -0.05, 0.075]) ** 2).sum(1) / 0.03**2)
    truth = []
    for time in times:
        shape = rest + np.where(eye, 0, fall)[:, None] * [0.0, -0.01 * np.sin(6 * time), 0.004]
        center = model.basis.centers[0]
        shape[eye] = Rotation.from_rotvec([0.0, 0.4 * time, 0.1]).apply(rest[eye] - center) + center
        root = Rotation.from_euler("YX", [25 + 20 * time, 30 * time], degrees=True)
        truth.append(root.apply(shape) + np.array([0.1 * time, 0.02, 0.0]))
    truth = np.array(truth)
    points = model.vertices()
    term = position_term(truth, np.full(truth.shape[:2], 5e-4))
    start = model.rest(np.tile([1.0, 0.0, 0.0, 0.0], (frames, 1)), np.zeros((frames, 3)))
    found = positions(points, solve_surface(problem(model, [term], [points], times), start, 30))
    error = np.linalg.norm(found - truth, axis=-1)
    # The bump of 10 mm, its width two fifths of the shortest of 40 waves, is met to a few percent.
    assert np.linalg.norm(truth - found, axis=-1).mean() < 3e-4
    assert error[:, eye].mean() < 3e-4
    rigid = positions(points, solve_surface(problem(model, [term], [points], times), start, 0))
    assert np.linalg.norm(rigid - truth, axis=-1).mean() > 0.02


def test_frames_without_data_follow_their_neighbours_but_not_across_a_cut(model):
    frames, gap = 7, 3
    times = np.arange(frames) / FPS
    truth = np.stack([model.template.vertices_rest + np.array([0.02 * f, 0.0, 0.0]) for f in range(frames)])
    sigma = np.full(truth.shape[:2], 5e-4)
    sigma[gap] = np.nan
    points = model.vertices()
    start = model.rest(np.tile([1.0, 0.0, 0.0, 0.0], (frames, 1)), np.zeros((frames, 3)))
    term = position_term(truth, sigma)
    found = positions(points, solve_surface(problem(model, [term], [points], times), start, 30))
    np.testing.assert_allclose(found[gap], truth[gap], atol=5e-4)
    # After a cut the same frames are somewhere else; those before are where they were without them.
    takes = (np.arange(frames) >= 4).astype(np.int64)
    jumped = truth + np.where(takes, 0.3, 0.0)[:, None, None]
    term = position_term(jumped, np.full(sigma.shape, 5e-4))
    found = positions(points, solve_surface(problem(model, [term], [points], times, takes), start, 40))
    assert np.linalg.norm(found - jumped, axis=-1).max() < 1e-3


def test_points_that_nobody_sees_leave_the_rest_shape(model):
    term = position_term(
        np.full((2, len(model.template.vertices_rest), 3), np.nan), np.full((2, len(model.template.vertices_rest)), 1.0)
    )
    start = model.rest(np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)), np.full((2, 3), 0.1))
    points = model.vertices()
    found = solve_surface(problem(model, [term], [points], np.arange(2) / FPS), start, 5)
    np.testing.assert_allclose(positions(points, found), positions(points, start), atol=1e-9)


def test_what_never_moves_is_held_still(model):
    """Noisy points of an egg whose front alone moves: held, its back is nearer to the truth, and its front moves on."""
    frames, random = 6, np.random.default_rng(3)
    times = np.arange(frames) / FPS
    rest = model.template.vertices_rest
    fall = np.exp(-0.5 * ((rest - [0, -0.05, 0.075]) ** 2).sum(1) / 0.03**2)
    truth = rest + (0.008 * np.sin(4 * times))[:, None, None] * fall[:, None] * np.array([0.0, -1.0, 0.5])
    sparse = np.arange(1, len(rest), 2)
    points = model.points(at_vertices(sparse))
    term = position_term(
        truth[:, sparse] + 0.001 * random.normal(size=(frames, len(sparse), 3)), np.full((frames, len(sparse)), 0.002)
    )
    start = model.rest(np.tile([1.0, 0.0, 0.0, 0.0], (frames, 1)), np.zeros((frames, 3)))
    free = problem(model, [term], [points], times)
    motion = solve_surface(free, start, 20)
    held = replace(free, shape_prior=free.shape_prior.held_still(model.basis, motion, 0.0005))
    errors = [
        np.linalg.norm(positions(model.vertices(), m) - truth, axis=-1)
        for m in (motion, solve_surface(held, motion, 20))
    ]
    back, front = rest[:, 2] < -0.02, fall > 0.5
    assert errors[1][:, back].mean() < 0.7 * errors[0][:, back].mean()
    # The front keeps moving: it is met to less than the 1.7 mm by which its points are off.
    assert errors[1][:, front].mean() < 0.0015
