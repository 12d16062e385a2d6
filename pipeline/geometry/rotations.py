"""Rotations as matrices, quaternions (w, x, y, z) and rotation vectors (axis times angle).

Stable near 0 and pi.

All functions are batched over leading dimensions. Those for calibration and tracking are float64 NumPy;
`matrix_from_quaternion` also takes torch tensors, because Gaussians are oriented by it.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float64

from pipeline.base.array_module import Array, array_module, is_tensor

SMALLEST_NORM2 = 1e-12
"""Squared norm below which a quaternion counts as zero in `matrix_from_quaternion`: slopes there stay below ~4e6."""

SERIES_BELOW_RAD = 1e-4
"""Angle below which sin(x)/x is taken from its series 1 - x^2/6: the dropped x^4/120 is below 1e-18."""


def matrix_from_quaternion(
    quaternion: Float[Array, "*batch 4"],
) -> Float[Array, "*batch 3 3"]:
    """Rotation matrices of quaternions of any length; the zero quaternion gives the identity.

    R = I + (2 / |q|^2) (...), so nothing is normalised first: value and gradient are finite everywhere.
    """
    w, x, y, z = _components(quaternion)
    norm2 = w * w + x * x + y * y + z * z
    is_torch = is_tensor(quaternion)
    s = 2.0 / (norm2.clamp_min(SMALLEST_NORM2) if is_torch else np.maximum(norm2, SMALLEST_NORM2))
    entries = [
        1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y),
        s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x),
        s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y),
    ]  # fmt: skip
    stacked = array_module(quaternion).stack(entries, -1)
    return stacked.reshape(*quaternion.shape[:-1], 3, 3)


def quaternion_from_matrix(matrix: Float64[np.ndarray, "*batch 3 3"]) -> Float64[np.ndarray, "*batch 4"]:
    """Unit quaternions with w >= 0. The largest of the four components is found first (Shepperd 1978), so that no
    small number is divided by, at any angle.
    """
    m = matrix
    xx, yy, zz = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    # Rows of 4 q q^T: each is the quaternion times four times one of its components.
    outer = np.empty((*m.shape[:-2], 4, 4))
    outer[..., 0, 0] = 1 + xx + yy + zz
    outer[..., 1, 1] = 1 + xx - yy - zz
    outer[..., 2, 2] = 1 - xx + yy - zz
    outer[..., 3, 3] = 1 - xx - yy + zz
    outer[..., 0, 1] = outer[..., 1, 0] = m[..., 2, 1] - m[..., 1, 2]
    outer[..., 0, 2] = outer[..., 2, 0] = m[..., 0, 2] - m[..., 2, 0]
    outer[..., 0, 3] = outer[..., 3, 0] = m[..., 1, 0] - m[..., 0, 1]
    outer[..., 1, 2] = outer[..., 2, 1] = m[..., 0, 1] + m[..., 1, 0]
    outer[..., 1, 3] = outer[..., 3, 1] = m[..., 0, 2] + m[..., 2, 0]
    outer[..., 2, 3] = outer[..., 3, 2] = m[..., 1, 2] + m[..., 2, 1]
    largest = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    row = np.take_along_axis(outer, largest[..., None, None], axis=-2)[..., 0, :]
    quaternion = row / np.linalg.norm(row, axis=-1, keepdims=True)
    return np.where(quaternion[..., :1] < 0, -quaternion, quaternion)


def quaternion_from_rotation_vector(vector: Float64[np.ndarray, "*batch 3"]) -> Float64[np.ndarray, "*batch 4"]:
    """Unit quaternions of rotation vectors (axis times angle, radians)."""
    angle = np.linalg.norm(vector, axis=-1, keepdims=True)
    half = angle / 2
    safe = np.where(half < SERIES_BELOW_RAD, 1.0, half)
    half_sinc = 0.5 * np.where(half < SERIES_BELOW_RAD, 1 - half * half / 6, np.sin(safe) / safe)
    return np.concatenate([np.cos(half), half_sinc * vector], -1)


def rotation_vector_from_quaternion(quaternion: Float64[np.ndarray, "*batch 4"]) -> Float64[np.ndarray, "*batch 3"]:
    """Rotation vectors of at most pi, from quaternions of any length but zero.

    q and -q give the same.
    """
    q = quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)
    q = np.where(q[..., :1] < 0, -q, q)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    # atan2 keeps full precision at both ends, where acos(w) loses half of the digits.
    half = np.arctan2(sine, q[..., :1])
    safe = np.where(sine < SERIES_BELOW_RAD, 1.0, sine)
    return q[..., 1:] * np.where(sine < SERIES_BELOW_RAD, 2 + sine * sine / 3, 2 * half / safe)


def matrix_from_rotation_vector(vector: Float64[np.ndarray, "*batch 3"]) -> Float64[np.ndarray, "*batch 3 3"]:
    """Rotation matrices of rotation vectors (the exponential map)."""
    return matrix_from_quaternion(quaternion_from_rotation_vector(vector))


def rotation_vector_from_matrix(matrix: Float64[np.ndarray, "*batch 3 3"]) -> Float64[np.ndarray, "*batch 3"]:
    """Rotation vectors of rotation matrices (the logarithm), of at most pi."""
    return rotation_vector_from_quaternion(quaternion_from_matrix(matrix))


def multiply_quaternions(
    a: Float[Array, "*#batch 4"],
    b: Float[Array, "*#batch 4"],
) -> Float[Array, "*out 4"]:
    """The rotation b followed by the rotation a: matrix(a b) = matrix(a) @ matrix(b)."""
    aw, ax, ay, az = _components(a)
    bw, bx, by, bz = _components(b)
    product = [
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    ]
    return array_module(a).stack(product, -1)


def conjugate_quaternion(quaternion: Float64[np.ndarray, "*batch 4"]) -> Float64[np.ndarray, "*batch 4"]:
    """The inverse rotation of a unit quaternion."""
    return quaternion * np.array([1.0, -1.0, -1.0, -1.0])


def slerp(
    start: Float64[np.ndarray, "*#batch 4"], end: Float64[np.ndarray, "*#batch 4"], at: float | np.ndarray
) -> Float64[np.ndarray, "*out 4"]:
    """Unit quaternions at a fraction `at` of the shorter way to `end`.

    `at` is of a broadcastable shape without the 4.
    """
    step = rotation_vector_from_quaternion(multiply_quaternions(conjugate_quaternion(start), end))
    return multiply_quaternions(start, quaternion_from_rotation_vector(step * np.asarray(at, np.float64)[..., None]))


def skew(vector: Float64[np.ndarray, "*batch 3"]) -> Float64[np.ndarray, "*batch 3 3"]:
    """[v]x with [v]x u = v x u."""
    x, y, z = np.moveaxis(vector, -1, 0)
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(*vector.shape[:-1], 3, 3)


def left_jacobian(vector: Float64[np.ndarray, "*batch 3"]) -> Float64[np.ndarray, "*batch 3 3"]:
    """J with exp(v + dv) = exp(J dv) exp(v) to first order (Sola et al. 2018, eq. 145).

    J = I + (1 - cos a) / a^2 [v]x + (a - sin a) / a^3 [v]x^2 with a = |v|; the series near zero.
    """
    angle2 = (vector * vector).sum(-1)[..., None, None]
    angle = np.sqrt(angle2)
    # Larger than for the sine alone: a - sin a loses three times as many digits. Dropped terms are below 1e-10.
    small = angle < 1e-2
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 0.5 - angle2 / 24, (1 - np.cos(safe)) / safe**2)
    second = np.where(small, 1 / 6 - angle2 / 120, (safe - np.sin(safe)) / safe**3)
    cross = skew(vector)
    return np.eye(3) + first * cross + second * (cross @ cross)


def _components(quaternion: Array) -> tuple:
    """w, x, y, z. For tensors by one unbind, whose gradient is one stack; indexing would make four full zeros."""
    return quaternion.unbind(-1) if is_tensor(quaternion) else tuple(np.moveaxis(quaternion, -1, 0))
