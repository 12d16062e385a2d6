"""Pixels of a labelled face: a square, seen straight on, behind something, and not at all."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.geometry.texels import FACE, HEAD
from pipeline.metrics.face_region import known_face, shown_face

SIDE, FOCAL, DISTANCE = 64, 80.0, 1.0
SQUARES = np.array([[x, y, 0] for y in (-0.2, 0.1) for x in (-0.2, 0, 0.2)], np.float32)
FACES = np.array([[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]])
RIGHT = np.array([1, 2, 4, 5])
BETWEEN = np.array([[-2, -2, 0.3], [2, -2, 0.3], [0, 3, 0.3]], np.float32)
"""A large triangle between the squares and the camera."""


def seen(region, extra=None):
    """The pixels of the right square by a camera that looks down on both, its image's right along x, up along y."""
    vertices = SQUARES if extra is None else np.concatenate([SQUARES, extra])
    faces = FACES if extra is None else np.concatenate([FACES, [[6, 7, 8]]])
    K = np.array([[FOCAL, 0, SIDE / 2], [0, FOCAL, SIDE / 2], [0, 0, 1]])
    rotation, shift = np.diag([1.0, -1, -1]), np.array([0, 0, DISTANCE])
    image = SimpleNamespace(R=rotation, t=shift, K=K, width=SIDE, height=SIDE)
    return shown_face(faces, known_face({region: RIGHT}, SQUARES, {}))(SimpleNamespace(vertices=vertices), image)


@pytest.mark.parametrize("region", [FACE, HEAD])
def test_a_square_is_seen_where_it_projects_to(region):
    """x of 0 to 0.2 m are columns 32 to 48, y of 0.1 to -0.2 m rows 24 to 48."""
    expected = np.zeros((SIDE, SIDE), bool)
    expected[24:48, 32:48] = True
    assert np.array_equal(seen(region), expected)


def test_what_stands_in_front_hides_it():
    assert not seen(FACE, BETWEEN).any()
    behind = BETWEEN * np.array([1, 1, -1], np.float32)
    assert np.array_equal(seen(FACE, behind), seen(FACE))


def test_without_a_label_nothing_is_known():
    assert shown_face(FACES, known_face({}, SQUARES, {})) is None
    assert shown_face(FACES, RIGHT[:2]) is None  # no whole triangle
    assert np.array_equal(known_face({FACE: RIGHT, HEAD: RIGHT[:2]}, SQUARES, {}), RIGHT)


def test_two_eyes_tell_a_face_that_no_label_does():
    """Eyes at x of -0.2 and 0 on the lower row: 0.2 m apart, the point between them at (-0.1, -0.2)."""
    eyes = {"left": np.array([0]), "right": np.array([1])}
    # It is 0.44 m broad, which leaves out x of 0.2, and reaches 0.38 m: the upper row is 0.32 m away, its copy 0.41 m.
    assert known_face({}, SQUARES, eyes).tolist() == [0, 1, 3, 4]
    higher = SQUARES[3:] + np.array([0, 0.1, 0], np.float32)
    assert known_face({}, np.concatenate([SQUARES, higher]), eyes).tolist() == [0, 1, 3, 4]
    assert np.array_equal(known_face({FACE: RIGHT}, SQUARES, eyes), RIGHT)
    assert not len(known_face({}, SQUARES, {"left": eyes["left"]}))
