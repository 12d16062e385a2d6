"""Projected meshes against masks: shares of drawn squares by counting, and where a moving head's mesh lies."""

from __future__ import annotations

import logging

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from pipeline.base.errors import InputError
from pipeline.datasets.imported_capture import TrackedMeshes
from pipeline.datasets.mask_agreement import CLEAR_MARGIN, Agreement, MaskedView, agreement, decide, posed_vertices
from pipeline.geometry.cameras import Camera
from pipeline.geometry.mesh_files import decode_mesh

FOCAL, SIDE = 50.0, 60
CAMERA = Camera(np.eye(3), np.zeros(3), np.array([[FOCAL, 0, 30], [0, FOCAL, 30], [0, 0, 1]]), np.zeros(5), SIDE, SIDE)
FACES = np.array([[0, 1, 2], [0, 2, 3]])


def square(x: tuple[int, int], y: tuple[int, int]) -> np.ndarray:
    """The corners of a rectangle of pixels, a metre before the camera."""
    corners = np.array([[x[0], y[0]], [x[1], y[0]], [x[1], y[1]], [x[0], y[1]]], np.float64)
    return np.concatenate([(corners - 30) / FOCAL, np.ones((4, 1))], 1)


def mask(x: tuple[int, int], y: tuple[int, int]) -> np.ndarray:
    drawn = np.zeros((SIDE, SIDE), np.uint8)
    drawn[slice(*y), slice(*x)] = 255
    return drawn


def test_overlap_is_the_common_part_of_all_that_either_covers():
    """A square of 20 x 20 and a mask of 30 x 20 share 10 x 20; a second view, of which the mask covers all."""
    first = MaskedView("a", mask((20, 50), (10, 30)), square((10, 30), (10, 30)))
    second = MaskedView("a", mask((0, 60), (0, 20)), square((5, 15), (5, 15)))
    found = agreement([first], {"a": CAMERA}, FACES)
    assert (found.inside, found.overlap) == pytest.approx((200 / 400, 200 / (400 + 600 - 200)))
    pooled = agreement([first, second], {"a": CAMERA}, FACES)
    assert (pooled.inside, pooled.overlap) == pytest.approx((300 / 500, 300 / (800 + 1200)))


@pytest.mark.parametrize("moves", [True, False])
def test_mesh_of_a_head_lies_where_its_motion_takes_it(tmp_path, moves):
    """x = R s p + t, of a head that has turned about all axes, its mesh in millimetres."""
    points = np.random.default_rng(0).normal(size=(4, 3)).round(3) * 1000
    lines = [f"v {x} {y} {z}" for x, y, z in points] + ["f 1 2 3", "f 1 3 4"]
    (tmp_path / "7.obj").write_text("\n".join(lines) + "\n")
    motion = np.concatenate([Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix(), [[0.3], [1.2], [-0.5]]], 1)
    row = {"frame": 7, "path": "7.obj", "world_from_mesh": motion.ravel().tolist() if moves else None}
    rest = decode_mesh((tmp_path / "7.obj").read_bytes(), tmp_path / "7.obj")
    found = posed_vertices(tmp_path, TrackedMeshes(pd.DataFrame([row]), 0.001, rest), 7)
    expected = points / 1000 @ motion[:, :3].T + motion[:, 3] if moves else points / 1000
    np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize("closer", [0.6, 0.9])
def test_conventions_that_fit_nearly_as_well_are_refused_with_all_numbers(closer, caplog):
    """Of three readings, two of which overlap the masks, though one does so less."""
    found = {"a": Agreement(0.5, 0.05), "b": Agreement(0.9, 0.8), "c": Agreement(0.9, 0.8 - closer * CLEAR_MARGIN)}
    with caplog.at_level(logging.INFO), pytest.raises(InputError) as caught:
        decide(found, "set")
    assert f"b: 0.800, c: {0.8 - closer * CLEAR_MARGIN:.3f}, a: 0.050" in str(caught.value)
    assert all(f"read as {name}: overlap {each.overlap:.3f}" in caplog.text for name, each in found.items())
    assert decide(found | {"c": Agreement(0.9, 0.8 - 1.01 * CLEAR_MARGIN)}, "set") == "b"
