"""The two-sphere eye against closed forms: limbus, volume of a union of balls, normals, and turns without roll."""

import numpy as np
import pytest
import torch

from pipeline.eyes.eye_shape import EyeShape, eye_surface, turn_to, usual_shape

SHAPE = EyeShape(0.012, 0.0078, 0.0056)
AXIS = np.array([0.6, -0.48, 0.64])


def directions(count, seed=0):
    found = np.random.default_rng(seed).normal(size=(count, 3))
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def surface(shape, w, axis=AXIS):
    return eye_surface(w, axis, shape.radius_m, shape.cornea_radius_m, shape.cornea_offset_m)


def around(axis, angle, turns):
    """Directions at an angle from the axis."""
    side = np.cross(axis, [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    ring = np.cos(turns)[:, None] * side + np.sin(turns)[:, None] * np.cross(axis, side)
    return np.cos(angle) * axis + np.sin(angle) * ring


def test_every_point_lies_on_its_sphere_and_in_no_other():
    w = directions(4000)
    found = surface(SHAPE, w)
    from_cornea = np.linalg.norm(found.points - SHAPE.cornea_offset_m * AXIS, axis=1)
    from_center = np.linalg.norm(found.points, axis=1)
    assert found.on_cornea.any() and not found.on_cornea.all()
    np.testing.assert_allclose(from_cornea[found.on_cornea], SHAPE.cornea_radius_m, rtol=1e-13)
    np.testing.assert_allclose(from_center[~found.on_cornea], SHAPE.radius_m, rtol=1e-13)
    assert (from_center >= SHAPE.radius_m * (1 - 1e-13)).all()
    assert (from_cornea >= SHAPE.cornea_radius_m * (1 - 1e-13)).all()
    np.testing.assert_allclose(found.points / from_center[:, None], w, atol=1e-14)


def test_spheres_meet_in_the_circle_of_the_closed_form():
    """Both spheres pass through it, so the surface has no step there; within a hair of it they take turns."""
    turns, hair = np.linspace(0, 6, 50), 1e-7
    inside, outside = (surface(SHAPE, around(AXIS, SHAPE.limbus_angle + side * hair, turns)) for side in (-1, 1))
    assert inside.on_cornea.all() and not outside.on_cornea.any()
    # The radius changes along the cornea by at most the tangent of its slope, 0.55 here.
    np.testing.assert_allclose(inside.points, outside.points, atol=2 * hair * SHAPE.radius_m)
    circle = SHAPE.radius_m * np.sin(SHAPE.limbus_angle)
    height = SHAPE.radius_m * np.cos(SHAPE.limbus_angle) - SHAPE.cornea_offset_m
    assert np.hypot(circle, height) == pytest.approx(SHAPE.cornea_radius_m, rel=1e-13)


def test_volume_is_that_of_two_balls_less_their_lens():
    r, c, d = SHAPE.radius_m, SHAPE.cornea_radius_m, SHAPE.cornea_offset_m
    lens = np.pi * (r + c - d) ** 2 * (d * d + 2 * d * (r + c) - 3 * (r - c) ** 2) / (12 * d)
    balls = 4 / 3 * np.pi * (r**3 + c**3)
    # 1/3 of the integral of rho^3 over directions, either side of the crease by Gauss' rule.
    volume = 0.0
    limbus = np.cos(SHAPE.limbus_angle)
    for low, high in ((-1.0, limbus), (limbus, 1.0)):
        nodes, weights = np.polynomial.legendre.leggauss(40)
        cosine = (low + high) / 2 + (high - low) / 2 * nodes
        w = np.stack([np.sqrt(1 - cosine**2), 0 * cosine, cosine], 1)
        rho = np.linalg.norm(surface(SHAPE, w, np.array([0.0, 0.0, 1.0])).points, axis=1)
        volume += 2 * np.pi / 3 * (weights * rho**3).sum() * (high - low) / 2
    assert volume == pytest.approx(balls - lens, rel=1e-12)


@pytest.mark.parametrize(
    "shape", [SHAPE, usual_shape(0.0125), EyeShape(0.012, 0.009, 0.0), EyeShape(0.01, 0.02, 0.001)]
)
def test_normals_are_across_the_surface(shape):
    """Against differences of neighbouring points, away from the crease."""
    w, step = directions(500, 1), 1e-6
    w = w[np.abs(np.arccos(w @ AXIS) - shape.limbus_angle) > 1e-3]
    found = surface(shape, w)
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1, rtol=1e-13)
    assert ((found.normals * w).sum(1) > 0).all()
    for other in directions(3, 2):
        moved = w + step * other
        moved /= np.linalg.norm(moved, axis=1, keepdims=True)
        along = (surface(shape, moved).points - found.points) / (step * shape.radius_m)
        assert np.abs((along * found.normals).sum(1)).max() < 10 * step


def test_shapes_of_no_eye_are_named():
    assert not SHAPE.fault() and not usual_shape(0.0125).fault() and not EyeShape(0.0125, 0.0125, 0.0).fault()
    assert "smaller than its eyeball (12.00 mm), found 13.00 mm" in EyeShape(0.012, 0.013, 0.004).fault()
    assert "centre 15.00 mm away" in EyeShape(0.012, 0.0078, 0.015).fault()
    for numbers in ((0.0, 0.01, 0.0), (0.012, -1.0, 0.0), (0.012, 0.0078, -0.001), (np.nan, 0.01, 0.0)):
        assert "positive radii" in EyeShape(*numbers).fault()


def test_usual_eye_has_the_limbus_and_the_bulge_of_eyes():
    shape = usual_shape(0.012)
    assert shape.radius_m * np.sin(shape.limbus_angle) == pytest.approx(0.49 * 0.012, rel=1e-12)
    assert shape.cornea_offset_m + shape.cornea_radius_m - shape.radius_m == pytest.approx(0.00114, abs=1e-5)
    assert EyeShape(0.0125, 0.0125, 0.0).is_sphere and not shape.is_sphere


def test_turns_bring_the_axis_to_the_gaze_without_roll():
    axes, gazes = directions(200, 3), directions(200, 4)
    turns = turn_to(axes, 1.7 * gazes)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", turns, axes), gazes, atol=1e-12)
    np.testing.assert_allclose(turns @ turns.transpose(0, 2, 1), np.tile(np.eye(3), (200, 1, 1)), atol=1e-12)
    about = np.cross(axes, gazes)  # stays where it is: nothing turns about the axis
    np.testing.assert_allclose(np.einsum("nij,nj->ni", turns, about), about, atol=1e-12)


def test_tensors_give_what_arrays_give():
    w = directions(300, 5)
    arrays, tensors = surface(SHAPE, w), surface(SHAPE, torch.as_tensor(w), torch.as_tensor(AXIS))
    np.testing.assert_array_equal(tensors.on_cornea.numpy(), arrays.on_cornea)
    np.testing.assert_allclose(tensors.points.numpy(), arrays.points, rtol=1e-14, atol=1e-17)
    np.testing.assert_allclose(tensors.normals.numpy(), arrays.normals, rtol=1e-13, atol=1e-16)
    gazes = directions(300, 6)
    np.testing.assert_allclose(
        turn_to(torch.as_tensor(w), torch.as_tensor(gazes)).numpy(), turn_to(w, gazes), atol=1e-13
    )
