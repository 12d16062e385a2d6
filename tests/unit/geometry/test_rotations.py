"""Rotations against scipy's, and at their hard places: angles near 0 and pi, zero quaternions, both signs."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation, Slerp

from pipeline.geometry.rotations import (
    conjugate_quaternion,
    matrix_from_quaternion,
    matrix_from_rotation_vector,
    multiply_quaternions,
    quaternion_from_matrix,
    quaternion_from_rotation_vector,
    rotation_vector_from_matrix,
    rotation_vector_from_quaternion,
    skew,
    slerp,
)

ROUNDING = 1e-14
"""A few dozen float64 operations on numbers of about one."""


def wxyz(rotation: Rotation) -> np.ndarray:
    return np.roll(rotation.as_quat(), 1, axis=-1)


def same_rotation(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.minimum(np.abs(a - b).max(-1), np.abs(a + b).max(-1))


@pytest.fixture
def many() -> Rotation:
    return Rotation.random(500, rng=np.random.default_rng(3))


def test_every_conversion_agrees_with_scipy(many: Rotation) -> None:
    q, m, v = wxyz(many), many.as_matrix(), many.as_rotvec()
    assert np.abs(matrix_from_quaternion(q) - m).max() < ROUNDING
    assert same_rotation(quaternion_from_matrix(m), q).max() < ROUNDING
    assert same_rotation(quaternion_from_rotation_vector(v), q).max() < ROUNDING
    assert np.abs(rotation_vector_from_quaternion(q) - v).max() < 10 * ROUNDING
    assert np.abs(matrix_from_rotation_vector(v) - m).max() < ROUNDING
    assert np.abs(rotation_vector_from_matrix(m) - v).max() < 1e-7  # near pi a matrix determines the axis to sqrt(eps)


def test_product_conjugate_and_slerp_agree_with_scipy(many: Rotation) -> None:
    other = Rotation.random(500, rng=np.random.default_rng(4))
    assert same_rotation(multiply_quaternions(wxyz(many), wxyz(other)), wxyz(many * other)).max() < ROUNDING
    assert same_rotation(conjugate_quaternion(wxyz(many)), wxyz(many.inv())).max() < ROUNDING
    for a, b in zip(many[:20], other[:20], strict=True):
        expected = wxyz(Slerp([0, 1], Rotation.concatenate([a, b]))(0.3))
        assert same_rotation(slerp(wxyz(a), wxyz(b), 0.3), expected) < 10 * ROUNDING
        assert same_rotation(slerp(wxyz(a), -wxyz(b), 0.3), expected) < 10 * ROUNDING


@pytest.mark.parametrize("angle", [0.0, 1e-300, 1e-12, 1e-8, 0.99e-4, 1.01e-4, 1e-3, 1.0, np.pi - 1e-3, np.pi - 1e-9])
def test_logarithm_undoes_exponential_at_every_angle(angle: float) -> None:
    axes = np.random.default_rng(0).normal(size=(50, 3))
    vectors = angle * axes / np.linalg.norm(axes, axis=1, keepdims=True)
    back = rotation_vector_from_quaternion(quaternion_from_rotation_vector(vectors))
    assert np.abs(back - vectors).max() <= ROUNDING * max(angle, 1e-290)
    assert np.abs(quaternion_from_rotation_vector(vectors) - wxyz(Rotation.from_rotvec(vectors))).max() < ROUNDING


@pytest.mark.parametrize("axis", np.concatenate([np.eye(3), [[0.6, 0.8, 0.0], [1 / 3, 2 / 3, 2 / 3]]]))
def test_half_turns_survive_the_matrix(axis: np.ndarray) -> None:
    matrix = 2 * np.outer(axis, axis) - np.eye(3)
    vector = rotation_vector_from_matrix(matrix)
    assert np.linalg.norm(vector) == pytest.approx(np.pi, abs=1e-12)
    assert abs(vector @ axis) == pytest.approx(np.pi, abs=1e-12)


def test_skew_is_the_cross_product() -> None:
    a, b = np.random.default_rng(1).normal(size=(2, 10, 3))
    assert np.allclose((skew(a) @ b[..., None])[..., 0], np.cross(a, b), rtol=0, atol=ROUNDING)


def test_torch_agrees_with_numpy_and_has_its_derivative(many: Rotation) -> None:
    q = torch.tensor(wxyz(many)[:5] * 2.5, requires_grad=True)
    assert np.abs(matrix_from_quaternion(q).detach().numpy() - many[:5].as_matrix()).max() < ROUNDING
    assert torch.autograd.gradcheck(matrix_from_quaternion, (q,))


@pytest.mark.parametrize("size", [0.0, 1e-30, 1e-12, 1e-6, 1e-3])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_tiny_quaternions_have_finite_values_and_gradients(size: float, dtype: torch.dtype) -> None:
    q = (size * torch.tensor([[1.0, 2.0, -1.0, 0.5], [0.0, 1.0, 0.0, 0.0]], dtype=dtype)).requires_grad_()
    matrix = matrix_from_quaternion(q)
    (matrix * torch.arange(9, dtype=dtype).reshape(3, 3)).sum().backward()
    assert torch.isfinite(matrix).all()
    assert torch.isfinite(q.grad).all()
    assert q.grad.abs().max() < 1e8
    if size == 0.0:
        assert torch.equal(matrix, torch.eye(3, dtype=dtype).expand(2, 3, 3))


def test_quaternions_of_matrices_lie_on_the_half_of_the_identity(many: Rotation) -> None:
    """So neighbouring frames have neighbouring numbers: w = cos(angle / 2) >= 0 for angles up to pi."""
    assert (many.magnitude() > 2.5).any() and (many.magnitude() < 1.0).any()
    w = quaternion_from_matrix(many.as_matrix())[:, 0]
    assert np.abs(w - np.cos(many.magnitude() / 2)).max() < ROUNDING
