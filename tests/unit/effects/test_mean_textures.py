"""What texels get that cameras do not see, and frames between fully lit ones."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pipeline.base.exr import write_exr
from pipeline.capture.images import ImageSource
from pipeline.effects.mean_textures import SeenColors, between_lit_frames, fill_unseen, joined, seen_colors
from pipeline.geometry.cameras import Camera
from tests.support.avatars.sheet import make_sheet

ROUNDING = 1e-12
"""A few roundings of numbers of size one."""

PLACES = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3.6, 0, 0]])


def seen(grey, weight):
    weight = np.array(weight, np.float64)
    return SeenColors(np.array(grey, np.float64)[:, None] * (weight > 0)[:, None] * np.ones(3), weight)


def test_frames_join_by_their_weights():
    both = joined([seen([0.2, 0.4, 0, 0], [1, 2, 0, 0]), seen([0.8, 0.4, 0.6, 0], [3, 1, 0.5, 0])])
    np.testing.assert_allclose(both.mean[:, 0], [0.65, 0.4, 0.6, 0], atol=ROUNDING)
    np.testing.assert_allclose(both.weight, [4, 3, 0.5, 0])


def test_unseen_texels_take_their_own_colour_of_other_frames_then_a_neighbours():
    filled = fill_unseen([seen([0.2, 0.4, 0, 0], [1, 2, 0, 0]), seen([0.8, 0, 0.6, 0], [3, 0, 0.5, 0])], PLACES)
    np.testing.assert_allclose(filled[0][:, 1], [0.2, 0.4, 0.6, 0.6], atol=ROUNDING)
    np.testing.assert_allclose(filled[1][:, 2], [0.8, 0.4, 0.6, 0.6], atol=ROUNDING)


def test_nothing_seen_at_all_is_black():
    filled = fill_unseen([seen([0, 0, 0, 0], [0, 0, 0, 0])] * 2, PLACES)
    np.testing.assert_array_equal(filled, np.zeros((2, 4, 3)))


def test_textures_between_lit_frames_of_a_take():
    lit = np.array([False, True, False, False, True, False, True, False])
    takes = np.array([0, 0, 0, 0, 0, 1, 1, 1])
    textures = np.array([0.0, 3.0, 9.0])[:, None, None] * np.ones((1, 2, 3))
    found = between_lit_frames(textures, lit, takes)
    np.testing.assert_allclose(found[:, 1, 1], [0, 0, 1, 2, 3, 9, 9, 9], atol=ROUNDING)


def looking_at_the_sheet(azimuth: float) -> Camera:
    """Two metres away, turned about the vertical from straight above the sheet; an image of 80 x 80 pixels."""
    center = 2 * np.array([np.sin(azimuth), 0.0, np.cos(azimuth)])
    right = np.array([np.cos(azimuth), 0.0, -np.sin(azimuth)])
    R = np.stack([right, [0.0, -1.0, 0.0], -center / 2])
    K = np.array([[150.0, 0, 40], [0, 150, 40], [0, 0, 1]])
    return Camera(R, -R @ center, K, np.zeros(5), 80, 80)


def colors_of_the_sheet(folder: Path, cameras: dict[str, Camera], images: dict[str, np.ndarray], power: float):
    """The sheet's colours in one frame of these images, and its texels."""
    atlas = make_sheet(12)
    for name, image in images.items():
        write_exr(folder / f"{name}.exr", np.repeat(image[..., None], 3, 2).astype(np.float32), half=False)
    table = pd.DataFrame({"camera": list(images), "frame": 0, "path": [f"{name}.exr" for name in images]})
    source, vertices = ImageSource(folder, "linear", 0.0), atlas.rest_vertices.astype(np.float32)
    return seen_colors(source, table, cameras, {}, atlas, vertices, power), atlas


@pytest.mark.parametrize("power", [1.0, 3.0])
def test_views_count_by_the_cosine_they_see_the_surface_at(tmp_path, power):
    """A surface that looks brighter from aside: 0.2 from straight above, 0.8 from 50 degrees."""
    cameras = {"above": looking_at_the_sheet(0.0), "aside": looking_at_the_sheet(np.radians(50))}
    images = {"above": np.full((80, 80), 0.2), "aside": np.full((80, 80), 0.8)}
    found, atlas = colors_of_the_sheet(tmp_path, cameras, images, power)
    middle = atlas.texel_count // 2 + 6
    point = (atlas.rest_vertices[atlas.corners[middle]] * atlas.barycentric[middle][:, None]).sum(0)
    ways = [camera.center - point for camera in cameras.values()]
    weights = np.array([way[2] / np.linalg.norm(way) for way in ways]) ** power
    np.testing.assert_allclose(found.mean[middle], weights @ [0.2, 0.8] / weights.sum(), atol=2e-4)


def test_what_a_sensor_clips_is_no_colour(tmp_path):
    """White where the sensor had enough: brighter than anybody knows. Nor is what is no number."""
    camera = looking_at_the_sheet(0.0)
    image = np.full((80, 80), 0.5)
    image[:, 44:] = 1.0
    image[:36] = np.nan
    found, atlas = colors_of_the_sheet(tmp_path, {"above": camera}, {"above": image}, 1.0)
    points = (atlas.rest_vertices[atlas.corners] * atlas.barycentric[..., None]).sum(1)
    x, y = camera.project(points.astype(np.float64))[0].T
    inside, beside = (x < 43) & (y > 37) & (found.weight > 0), (x > 45) | (y < 35)
    assert min(inside.sum(), beside.sum(), ((x > 45) & (x < 52) & (y > 37)).sum()) > 20
    np.testing.assert_allclose(found.mean[inside], 0.5, atol=1e-6)
    assert not found.weight[beside].any()
