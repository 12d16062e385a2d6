"""One bounce between a floor and a ceiling, against the closed form of the view factor."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from pipeline.geometry.texels import Atlas, adjoining_texels
from pipeline.lighting.bounces import (
    bounced_irradiance,
    cosine_directions,
    nearest_texels,
    trace_bounces,
)
from pipeline.lighting.visibility import Occluders
from tests.support.avatars.sheet import make_sheet

SIDE, HEIGHT, SIZE, RAYS = 1.0, 0.5, 32, 1024
UP, DOWN = np.array([0.0, 0, 1]), np.array([0.0, 0, -1])


@pytest.fixture(scope="module")
def room():
    return make_room(DOWN)


def make_room(ceiling_faces, rays=RAYS):
    """Floor in the left half of the map, ceiling in the right; u grows along x, v along y in both.

    Returns points, whether they are the ceiling's, and texels that their rays hit.
    """
    half = SIDE / 2
    floor = np.array([[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]])
    ceiling = floor + HEIGHT * UP
    uv = np.array([[0, 0], [0.5, 0], [0.5, 1], [0, 1]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 6, 5], [4, 7, 6]], np.int32)
    corner_uv = np.concatenate([uv, uv + np.array([0.5, 0])])[faces]
    row, column = np.mgrid[:SIZE, :SIZE].reshape(2, -1)
    u, v = (column + 0.5) / SIZE, (row + 0.5) / SIZE
    x, y = (2 * u % 1 - 0.5) * SIDE, (v - 0.5) * SIDE
    above = u > 0.5
    points = np.stack([x, y, above * HEIGHT], 1)
    count = SIZE * SIZE
    atlas = Atlas(
        size=SIZE, faces=faces, uv=corner_uv.astype(np.float32), weld=np.arange(8, dtype=np.int32),
        rest_vertices=np.concatenate([floor, ceiling]).astype(np.float32),
        texel=np.stack([row, column], 1).astype(np.int32), face=np.where(above, 2, 0).astype(np.int32),
        barycentric=np.zeros((count, 3), np.float32), chart=above.astype(np.int32),
        tangent_weights=np.zeros((count, 3), np.float32),
    )  # fmt: skip
    vertices = np.concatenate([floor, ceiling])
    frames = np.where(above[:, None, None], np.diag([1.0, -1, -1]), np.eye(3))
    normals = np.array([UP, UP, ceiling_faces, ceiling_faces])
    hits = trace_bounces(atlas, Occluders(vertices, faces), points, frames, normals, rays)
    return points, above, torch.as_tensor(hits)


def view_factor_above_center() -> float:
    """From a surface element to a parallel square of side SIDE centred HEIGHT above it (Howell, factor B-4)."""
    x = SIDE / 2 / HEIGHT
    return 4 / (2 * math.pi) * 2 * x / math.sqrt(1 + x * x) * math.atan(x / math.sqrt(1 + x * x))


def center_of(points, chosen):
    return int(np.flatnonzero(chosen)[np.linalg.norm(points[chosen][:, :2], axis=1).argmin()])


@pytest.mark.parametrize("lit, share", [("all", 1.0), ("left", 0.5)])
def test_irradiance_under_a_shining_ceiling(room, lit, share):
    points, above, hits = room
    middle = center_of(points, ~above)
    left = 0.5 - 0.5 * np.sign(points[:, 0] - points[middle, 0])  # the column right above counts half
    shining = above * (left if lit == "left" else 1.0)
    radiance = 2.0 * torch.as_tensor(shining, dtype=torch.float32)[:, None]
    found = bounced_irradiance(radiance, hits)[middle].item()
    assert found == pytest.approx(share * 2 * math.pi * view_factor_above_center(), rel=0.05)


def test_light_does_not_come_from_the_floor_itself_nor_from_outside(room):
    points, above, hits = room
    on_floor = bounced_irradiance(torch.as_tensor(~above, dtype=torch.float32)[:, None], hits)
    assert on_floor[~above].abs().max() == 0
    assert on_floor[above].min() > 0
    assert (hits[center_of(points, ~above)] == len(points)).any(), "some rays leave between floor and ceiling"


def test_inside_of_a_surface_hides_and_does_not_shine():
    """A ceiling whose outside looks up: the floor below it sees no sky, and no light from it either."""
    _, above, hits = make_room(UP, 64)
    shining = bounced_irradiance(torch.as_tensor(above, dtype=torch.float32)[:, None], hits)
    assert shining[~above].abs().max() == 0


def test_directions_follow_the_cosine():
    """Means over the cosine-weighted hemisphere: of the cosine 2/3, of its square 1/2, across 0."""
    directions = cosine_directions(512, 3)
    assert np.allclose(np.linalg.norm(directions, axis=-1), 1)
    assert directions[..., 2].mean(1) == pytest.approx(np.full(3, 2 / 3), abs=2e-3)
    assert (directions[..., 2] ** 2).mean(1) == pytest.approx(np.full(3, 0.5), abs=1e-3)
    assert np.abs(directions[..., :2].mean(1)).max() < 0.01


def test_a_full_map_keeps_its_own_texels():
    sheet = make_sheet(8)
    assert (nearest_texels(sheet)[sheet.texel[:, 0], sheet.texel[:, 1]] == np.arange(64)).all()


def test_shared_rays_are_the_mean_over_texels_of_the_same_chart():
    """A full 4 x 4 map of two charts, columns 0 and 1 against 2 and 3, by hand."""
    sheet = replace(make_sheet(4), chart=np.tile([0, 0, 1, 1], 4).astype(np.int32))
    hits = torch.full((16, 2), 16, dtype=torch.int32)
    hits[5] = 0  # row 1, column 1: both rays meet texel 0
    radiance = torch.zeros(16, 3)
    radiance[0] = torch.tensor([1.0, 2.0, 4.0])
    plain = bounced_irradiance(radiance, hits)
    shared = bounced_irradiance(radiance, hits, torch.as_tensor(adjoining_texels(sheet)))
    assert torch.allclose(plain[5], math.pi * radiance[0]) and plain[np.arange(16) != 5].abs().max() == 0
    for texel, share in {0: 1 / 4, 1: 1 / 4, 4: 1 / 6, 5: 1 / 6, 8: 1 / 6, 2: 0, 6: 0, 12: 0}.items():
        assert torch.allclose(shared[texel], share * math.pi * radiance[0]), texel


def test_rays_of_texels_side_by_side_together_are_as_good_as_so_many_of_one():
    """Mean of the cosine over 9 points of 16 rays each, against 2 / 3: as 144 rays, not as 16 that agree."""
    directions = cosine_directions(16, 9)
    heights = directions[..., 2].reshape(-1)
    assert abs(heights.mean() - 2 / 3) < 1 / 144
    assert len(np.unique(heights.round(9))) == 144
