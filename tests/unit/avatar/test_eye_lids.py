"""What lids hide of eyes, and of what eyes mirror."""

import numpy as np
import pytest
import torch

from benchmarks.mirror_glints import glint_points
from pipeline.avatar.pose import FrameInputs
from tests.unit.avatar.eyeballs import (
    AHEAD,
    CENTERS,
    EYES,
    LIGHTS,
    make_atlas,
    make_avatar,
    make_frame,
)


def lid(low, high):
    """A wall in front of both eyes, between two heights."""
    corners = np.array([[-0.1, low, 0.08], [0.1, low, 0.08], [0.1, high, 0.08], [-0.1, high, 0.08]])
    return corners, np.array([[0, 1, 2], [0, 2, 3]])


def test_lids_hide_what_is_behind_them():
    """A wall over the upper half: what sees none of it is open, what is above the gap sees less."""
    half = make_atlas(64, lid(0.010, 0.2))
    avatar = make_avatar(half, EYES)
    frame = avatar.prepare(FrameInputs(half, make_frame(half, AHEAD, LIGHTS[:1])))
    points = frame["means"].detach()[avatar.eyes.chosen]
    share = frame["lids"].opening
    in_front = points[:, 2] > 0.0705
    assert share[in_front & (points[:, 1] > 0.017)].max() < 0.45
    assert share[in_front & (points[:, 1] < 0.003)].min() > 0.55
    assert share[points[:, 2] < 0.051].min() > 0.95  # nothing behind the eyes
    unlit = make_avatar(half, EYES, shadow=True)
    shaded = unlit.prepare(FrameInputs(half, make_frame(half, AHEAD, LIGHTS[:1])))
    ratio = (frame["diffuse"] / shaded["diffuse"]).detach()[avatar.eyes.chosen]
    assert torch.allclose(ratio[shaded["diffuse"][avatar.eyes.chosen] > 0.01], share[:, None].expand(-1, 3)[
        shaded["diffuse"][avatar.eyes.chosen] > 0.01], atol=1e-5)  # fmt: skip


@pytest.mark.parametrize(("wall", "passes"), [((0.010, 0.2), 0.0), ((0.030, 0.2), 1.0)])
def test_glints_of_lights_behind_a_lid_are_not_seen(wall, passes):
    """The camera looks up under the wall; the light above it shows only if the wall begins higher."""
    camera, light, center = np.array([0.03, -0.5, 1.0]), np.array([0.03, 0.6, 1.0]), CENTERS["eye_l"]
    atlas = make_atlas(64, lid(*wall))
    frame = make_avatar(atlas, EYES).prepare(FrameInputs(atlas, make_frame(atlas, AHEAD, light[None])))
    (point,) = glint_points(center, AHEAD, EYES["eye_l"].shape, camera, light)
    normal = point - center - EYES["eye_l"].shape.cornea_offset_m * AHEAD
    normal = normal / np.linalg.norm(normal)
    arrays = [torch.tensor(array[None], dtype=torch.float32) for array in (point, normal)]
    seen = frame["lids"].pass_mirrored(*arrays, torch.tensor(camera, dtype=torch.float32))
    assert seen.tolist() == [passes]
