"""Hard cases of rotations, lenses, meshes and rays, as curves.

Ours are the functions of `pipeline`, the naive ones those that `tests/hard_cases` holds them against; the truth is
known, or of float64 or mpmath.
"""

from __future__ import annotations

import math

import mpmath
import numpy as np
import torch

from docs.generate.hard_case_curves import Curves
from pipeline.geometry.lenses import FISHEYE
from pipeline.geometry.mesh import vertex_normals
from pipeline.geometry.rotations import left_jacobian, rotation_vector_from_matrix, skew
from pipeline.lighting.visibility import Occluders
from tests.support.meshes.lit_meshes import ball_in_shell
from tests.support.naive.motions import naive_jacobian_factor, naive_log
from tests.support.naive.surfaces import naive_normal, naive_visible, opencv_rays

AXIS = np.array([2.0, -1.0, 2.0]) / 3


def shadow_rays() -> Curves:
    """A ball in a shell, 2 % above it, 27 radii from the origin: wrong answers of shadow rays, of any size."""
    sizes = np.geomspace(1e-3, 1e4, 29)
    vertices, faces, points, normals = ball_in_shell()
    shift, light = np.array([20.0, -15, 10]), np.array([2.0, 3, 4])
    slope = ((light - points) * normals).sum(1)
    sees, sure = (slope > 0) & (np.arange(len(points)) >= len(points) // 2), np.abs(slope) > 1e-6
    ours, naive = [], []
    for size in sizes:
        places, starts, lamp = (size * (array + shift) for array in (vertices, points, light))
        seen = (
            Occluders(places, faces).visible(starts, normals, lamp)[0],
            naive_visible(places, faces, starts, normals, lamp),
        )
        for row, found in zip((ours, naive), seen, strict=True):
            row.append(100 * np.mean(found[sure] != sees[sure]))
    labels = "Shadow rays between a ball and a shell", "radius of the ball, m", "wrong answers, %"
    return Curves(*labels, sizes, np.array(ours), np.array(naive), np.zeros(29), (-2, 25), ("log", "linear"))


def sliver() -> Curves:
    """A triangle one metre long, lower and lower: length of its unit normal."""
    height = np.geomspace(1e-30, 1.0, 121)
    face, alone = torch.tensor([[0, 1, 2]]), torch.arange(3)
    ours, naive = [], []
    for value in height:
        corners = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0.5, value, 0]])
        ours.append(vertex_normals(corners, face, alone)[0].norm().item())
        naive.append(naive_normal(corners).norm().item())
    labels = "Normal of a triangle nearly without area", "its height, m", "length of the unit normal"
    return Curves(*labels, height, np.array(ours), np.array(naive), np.ones(121), (-0.1, 1.15), ("log", "linear"))


def fold_of_a_lens() -> Curves:
    """theta - 0.3 theta^3 folds at 60.4 degrees: beyond it there is no ray."""
    terms = np.array([-0.3, 0.0, 0.0, 0.0])
    largest = math.sqrt(1 / 0.9)
    fold = 2 / 3 * largest
    radius = np.linspace(0, 1.4 * fold, 141)
    pixels = np.stack([radius, 0 * radius], 1)
    degrees = [
        np.degrees(np.arctan2(rays[:, 0], rays[:, 2]))
        for rays in (FISHEYE.undistort(pixels, np.eye(3), terms), opencv_rays(pixels, np.eye(3), terms))
    ]
    with np.errstate(invalid="ignore"):
        truth = np.degrees(2 * largest * np.sin(np.arcsin(radius / fold) / 3))
    return Curves("Rays of a lens that folds over", "pixel, focal lengths from the middle", "ray from axis, degrees",
                  radius, *degrees, truth, (-100, 100))  # fmt: skip


def small_turn() -> Curves:
    """Derivative of the exponential of a small rotation vector: the factor of [v]x."""
    angle = np.geomspace(1e-12, 1.0, 121)
    ours = [left_jacobian(np.array([0, 0, value]))[1, 0] / value for value in angle]
    naive = [naive_jacobian_factor(value) for value in angle]
    with mpmath.workdps(60):
        truth = [float((1 - mpmath.cos(mpmath.mpf(value))) / mpmath.mpf(value) ** 2) for value in angle]
    labels = "Slope of the exponential of a small turn", "angle, rad", "(1 - cos a) / a²"
    return Curves(*labels, angle, *map(np.array, (ours, naive, truth)), (-0.05, 1.05), ("log", "linear"))


def half_turn() -> Curves:
    """Logarithm of a matrix whose angle is a little short of pi: how much short."""
    short = np.geomspace(1e-12, 1e-1, 111)
    cross = skew(AXIS)
    ours, naive = [], []
    for value in short:
        matrix = np.eye(3) + np.sin(value) * cross + (1 + np.cos(value)) * cross @ cross
        ours.append(math.pi - np.linalg.norm(rotation_vector_from_matrix(matrix)))
        with np.errstate(invalid="ignore", divide="ignore"):
            naive.append(abs(math.pi - np.linalg.norm(naive_log(matrix))))
    labels = "Logarithm of nearly a half turn", "rotation, rad short of a half turn", "logarithm, rad short of it"
    return Curves(*labels, short, np.array(ours), np.array(naive), short, (1e-13, 1e1), ("log", "log"))
