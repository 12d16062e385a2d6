"""What evidence of appearance is taken from: which images, which light, and how much normals turn."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from pipeline.effects.appearance_evidence import choose_images
from pipeline.effects.seen_texels import texel_turns
from pipeline.effects.texel_light import light_texels
from pipeline.lighting.frame_lights import FrameLights
from tests.support.avatars.sheet import make_sheet


def test_no_evidence_is_taken_from_what_is_held_out() -> None:
    """Cameras, frames and patterns of tests and of validation are for judging what the evidence decided."""
    frames, cameras = range(12), ("a", "b", "tested", "validated")
    table = pd.DataFrame([(frame, camera) for frame in frames for camera in cameras], columns=["frame", "camera"])
    images = table.assign(test_camera=table.camera == "tested", validation_camera=table.camera == "validated")
    split = ["train", "train", "test_frames", "validation"] * 3
    synced = pd.DataFrame({"frame": frames, "split": split, "fully_lit": [True, False, True, False] * 3})
    chosen = choose_images(images, synced, set(frames), fully_lit=10, partially_lit=10, cameras=10)
    assert set(chosen.camera) == {"a", "b"}
    assert sorted(set(chosen.frame)) == [0, 1, 4, 5, 8, 9]


def test_light_of_a_texel_falls_with_the_square_of_the_distance() -> None:
    """Lamps straight above the middle of a sheet, and aside: I / d^2, and the cosine of its angle."""
    atlas = make_sheet(9)
    middle = np.array([atlas.texel_count // 2])
    places = np.array([[0.0, 0.0, 2.0], [3.0, 0.0, 4.0], [0.0, 0.0, -1.0]])
    lamps = FrameLights(places, np.array([[8.0, 4.0, 2.0], [50.0, 25.0, 5.0], [1.0, 1.0, 1.0]]))
    vertices = atlas.rest_vertices.astype(np.float32)
    found = light_texels(atlas, vertices, middle, np.array([[0.0, 0.0, 1.0]]), lamps, rays=0)
    np.testing.assert_allclose(found.arriving[:, 0], [[2, 1, 0.5], [2, 1, 0.2], [1, 1, 1]], rtol=1e-6)
    np.testing.assert_allclose(found.cosine[:, 0], [1, 0.8, -1], atol=1e-6)
    assert found.seen[:, 0].tolist() == [True, True, False]
    np.testing.assert_allclose(found.direct[0], [3.6, 1.8, 0.66], rtol=1e-6)


@pytest.mark.parametrize("step", [0.02, 0.4])
def test_normals_that_turn_in_one_direction_turn_by_the_root_mean_square(step: float) -> None:
    """A sheet bent round a cylinder: by `step` to the right, by nothing below."""
    atlas = make_sheet(8)
    angle = step * atlas.texel[:, 1]
    normals = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], 1)
    inner = (atlas.texel < 7).all(1)
    np.testing.assert_allclose(texel_turns(atlas, normals)[inner], step / np.sqrt(2), rtol=1e-9)
