"""Evidence on scenes whose numbers are known in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.effects.scene_evidence import (
    distortion_evidence,
    near_field_evidence,
    rotation_spread_deg,
    shadow_evidence,
)
from pipeline.geometry.cameras import Camera
from tests.support.avatars.sheet import SIDE_M, make_sheet


def test_spread_of_rotations_is_the_95th_percentile_in_degrees():
    """Angles evenly from -40 to 40 degrees about one axis: 95 % are within 38 of their mean, no rotation."""
    turns = Rotation.from_rotvec(np.linspace(-np.radians(40), np.radians(40), 4001)[:, None] * [0.6, 0.0, 0.8])
    wxyz = np.roll(turns.as_quat(), 1, axis=1).astype(np.float32)
    still = np.tile(np.float32([1, 0, 0, 0]), (len(wxyz), 1))
    found = rotation_spread_deg(np.stack([wxyz, still], 1))
    assert found == pytest.approx([38.0, 0.0], abs=0.05)


def test_near_field_is_the_95th_percentile_of_the_light_on_a_floor():
    """From lamps above a square: |d^2(centre) / d^2(point) - 1|, by every lamp and point of a fine grid."""
    lamps = np.array([[0.1, 0.2, 0.8], [-0.3, 0.0, 1.1], [0.0, -0.4, 0.9]])
    atlas = make_sheet(32)
    place = (np.arange(200) + 0.5) / 200 * SIDE_M - SIDE_M / 2
    grid = np.stack(np.meshgrid(place, place, [0.0]), -1).reshape(-1, 1, 3)
    ratio = (lamps**2).sum(1) / ((lamps - grid) ** 2).sum(2)
    expected = 100 * np.quantile(np.abs(ratio - 1), 0.95)
    frames = [(np.asarray(atlas.rest_vertices), lamps)]
    found = near_field_evidence(atlas, frames, 20000, np.random.default_rng(0))
    # 20000 draws of 1024 texels know the middle of the square to 1 mm of 40 cm, and with it the percentile to 2 %.
    assert found.value == pytest.approx(expected, rel=0.03)


def test_shadows_are_the_percentage_that_a_far_surface_blocks():
    """A roof over half of a floor, under one lamp straight above: half of what faces it is blocked, by a roof afar."""
    floor = make_sheet(16)
    roof = floor.rest_vertices * [0.5, 1, 1] + [-SIDE_M / 4, 0, 0.5]
    faces = np.concatenate([floor.faces, floor.faces[:, ::-1] + 4])
    vertices = np.concatenate([floor.rest_vertices, roof]).astype(np.float32)
    uv = np.concatenate([floor.uv, floor.uv])
    atlas = replace(floor, faces=faces, uv=uv, rest_vertices=vertices, weld=np.arange(8, dtype=np.int32))
    lamp = np.array([[0.0, 0.0, 100.0]])
    found = shadow_evidence(atlas, [(vertices, lamp)], 10.0, 20000, np.random.default_rng(0))
    assert found.value == pytest.approx(50, abs=1.5)  # 0.35 % is its standard error.
    west = (atlas.rest_vertices[atlas.corners] * atlas.barycentric[..., None]).sum(1)[:, 0] < 0
    sides = {"west": np.flatnonzero(west), "east": np.flatnonzero(~west), "speck": np.arange(1)}
    parts = shadow_evidence(atlas, [(vertices, lamp)], 10.0, 20000, np.random.default_rng(0), sides).regions
    assert parts["west"] == 100 and parts["east"] == 0
    assert parts["speck"] == found.value  # Too few pairs to judge it by itself.
    near = shadow_evidence(atlas, [(vertices, lamp)], 150.0, 20000, np.random.default_rng(0))
    assert near.value == 0  # Nearer than 150 % of the extent: a fold of the surface itself.


def test_displacement_by_a_lens_is_that_of_the_farthest_corner_in_image_pixels():
    """k1 alone moves a point by f k1 r^3, most in the corner that is farthest from the principal point."""
    K = np.array([[500.0, 0, 340], [0, 500, 220], [0, 0, 1]])
    turn = Rotation.from_rotvec([0.3, -0.8, 0.4]).as_matrix()
    camera = Camera(turn, np.array([0.1, -0.2, 2.0]), K, np.array([0.01, 0, 0, 0, 0]), 640, 480)
    r = np.hypot(340, 260) / 500
    found = distortion_evidence({"a": camera}, downsample=4.0)
    assert found.value == pytest.approx(500 * 0.01 * r**3 / 4, rel=1e-6)
