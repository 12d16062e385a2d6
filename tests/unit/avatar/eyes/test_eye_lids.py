"""What lids hide of eyes, and of what eyes mirror."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch

from benchmarks.mirror_glints import glint_points
from pipeline.avatar.build import START_ALBEDO
from pipeline.avatar.eyes import explicit_eyes
from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.model import Avatar
from pipeline.avatar.texels.posed_texels import texel_spacing
from tests.support.avatars.eyeballs import (
    AHEAD,
    CENTERS,
    EYES,
    LIGHTS,
    gaze,
    make_atlas,
    make_avatar,
    make_frame,
    moved_head,
)


def lid(low, high):
    """A wall in front of both eyes, between two heights."""
    corners = np.array([[-0.1, low, 0.08], [0.1, low, 0.08], [0.1, high, 0.08], [-0.1, high, 0.08]])
    return corners, np.array([[0, 1, 2], [0, 2, 3]])


@cache
def walled_atlas(low, high):
    """Both eyes and a wall in front of them; unwrapping takes a second."""
    return make_atlas(64, lid(low, high))


def test_lids_hide_what_is_behind_them():
    """A wall over the upper half: what sees none of it is open, what is above the gap sees less."""
    half = walled_atlas(0.010, 0.2)
    avatar = make_avatar(half, EYES)
    frame = avatar.prepare(FrameInputs(half, make_frame(half, AHEAD, LIGHTS[:1])))
    points = frame.gaussians.means.detach()[avatar.eyes.chosen]
    share = frame.eyes.lids.opening
    in_front = points[:, 2] > 0.0705
    assert share[in_front & (points[:, 1] > 0.017)].max() < 0.45
    assert share[in_front & (points[:, 1] < 0.003)].min() > 0.55
    assert share[points[:, 2] < 0.051].min() > 0.95  # nothing behind the eyes
    unlit = make_avatar(half, EYES, shadow=True)
    shaded = unlit.prepare(FrameInputs(half, make_frame(half, AHEAD, LIGHTS[:1])))
    ratio = (frame.shading.diffuse / shaded.shading.diffuse).detach()[avatar.eyes.chosen]
    assert torch.allclose(ratio[shaded.shading.diffuse[avatar.eyes.chosen] > 0.01], share[:, None].expand(-1, 3)[
        shaded.shading.diffuse[avatar.eyes.chosen] > 0.01], atol=1e-5)  # fmt: skip


def test_lids_are_traced_once_for_all_lights_of_a_frame(monkeypatch):
    half, traced = walled_atlas(0.010, 0.2), []
    real = explicit_eyes.trace_lids
    monkeypatch.setattr(explicit_eyes, "trace_lids", lambda *given: traced.append(1) or real(*given))
    avatar = make_avatar(half, EYES)
    frame = avatar.trace(FrameInputs(half, make_frame(half, AHEAD, LIGHTS[:2])))
    lit = [avatar.prepare(frame.with_light(number)).eyes.lids for number in range(2)]
    assert len(traced) == 1 and lit[0].opening is lit[1].opening
    avatar.prepare(FrameInputs(half, make_frame(half, AHEAD, LIGHTS[:2])))
    assert len(traced) == 2


@pytest.mark.parametrize(("wall", "passes"), [((0.010, 0.2), 0.0), ((0.030, 0.2), 1.0)])
def test_glints_of_lights_behind_a_lid_are_not_seen(wall, passes):
    """The camera looks up under the wall; the light above it shows only if the wall begins higher."""
    camera, light, center = np.array([0.03, -0.5, 1.0]), np.array([0.03, 0.6, 1.0]), CENTERS["eye_l"]
    atlas = walled_atlas(*wall)
    frame = make_avatar(atlas, EYES).prepare(FrameInputs(atlas, make_frame(atlas, AHEAD, light[None])))
    (point,) = glint_points(center, AHEAD, EYES["eye_l"].shape, camera, light)
    normal = point - center - EYES["eye_l"].shape.cornea_offset_m * AHEAD
    normal = normal / np.linalg.norm(normal)
    arrays = [torch.tensor(array[None], dtype=torch.float32) for array in (point, normal)]
    seen = frame.eyes.lids.pass_mirrored(*arrays, torch.tensor(camera, dtype=torch.float32))
    assert seen.tolist() == [passes]


HEAD = {"avatar": "head", "shading": "harmonics", "code_size": 4, "decoder_channels": (4,), "near_field": True}
TRUNCATED = 0.034
"""How far harmonics of up to degree 8 are off the clamped cosine, of its peak: most at the horizon."""


def lambert(points, normals, light, wall):
    """Light of one lamp off a matte surface past a wall at z = 0.08, and how near its ray passes the wall's edges."""
    way = light - points
    distance = np.linalg.norm(way, axis=1)
    cosine = ((way * normals).sum(1) / distance).clip(0)
    height = (points + way * ((0.08 - points[:, 2]) / way[:, 2])[:, None])[:, 1]
    hidden = (height > wall[0]) & (height < wall[1])
    shown = START_ALBEDO / np.pi * 2.0 / distance**2 * cosine
    return np.where(hidden, 0.0, shown), np.abs(height[:, None] - wall).min(1)


@pytest.mark.parametrize("start", ["traced", "lambertian"])
@pytest.mark.parametrize("looks", [AHEAD, gaze(25, -10)])
def test_each_light_is_hidden_by_itself_wherever_the_eye_looks(start, looks):
    """A wall between the eyes and the lamp, under a moved head: each texel is as Lambert has it, or black; also where a
    transfer traced at rest would be in the shadow of the wall."""
    wall, light, head = (0.008, 0.03), np.array([[0.2, 0.3, 1.0]]), moved_head()
    atlas = walled_atlas(*wall)
    avatar = make_avatar(atlas, EYES, **HEAD, transfer_start=start)
    world = light @ head[:, :3].T + head[:, 3]
    frame = avatar.prepare(FrameInputs(atlas, make_frame(atlas, looks, world, head)))
    chosen = avatar.eyes.chosen
    points, normals = (
        tensor.detach()[chosen].double().numpy() for tensor in (frame.gaussians.means, frame.surface.posed.normals)
    )
    expected, from_edge = lambert((points - head[:, 3]) @ head[:, :3], normals @ head[:, :3], light[0], wall)
    clear = (from_edge > 1e-4) & ((points - head[:, 3]) @ head[:, 2] < 0.0799)
    found, peak = frame.shading.diffuse.detach()[chosen].numpy(), START_ALBEDO / np.pi * 2.0 / (1.0 - 0.08) ** 2
    assert (expected[clear] > 0.05).sum() > 50 and (expected[clear] == 0).sum() > 50
    np.testing.assert_allclose(found[clear], np.tile(expected[clear, None], 3), atol=TRUNCATED * peak)


def test_light_of_two_lamps_is_the_sum_of_the_light_of_each():
    """Whatever the lids hide from either, and whatever was learned."""
    atlas = walled_atlas(0.008, 0.03)
    avatar = make_avatar(atlas, EYES, **HEAD)
    with torch.no_grad():
        avatar.transfer_mono.add_(0.1 * torch.randn(avatar.transfer_mono.shape))

    def diffuse(lights):
        return avatar.prepare(FrameInputs(atlas, make_frame(atlas, gaze(10, 5), lights))).shading.diffuse.detach()

    both, first, second = diffuse(LIGHTS[:2]), diffuse(LIGHTS[:1]), diffuse(LIGHTS[1:2])
    assert torch.allclose(both, first + second, atol=1e-5)


def test_eyes_are_lit_alike_whatever_was_read_of_the_frame_before():
    """An avatar without eyes may have been shown in the same frame."""
    atlas = walled_atlas(0.008, 0.03)
    avatar, record = make_avatar(atlas, EYES, **HEAD), make_frame(atlas, gaze(10, 5), LIGHTS[:1])
    fresh, read = FrameInputs(atlas, record), FrameInputs(atlas, record)
    skin = torch.ones(atlas.texel_count, dtype=torch.bool).index_fill(0, avatar.eyes.chosen, False)
    before = read.harmonics.clone()
    frames = [avatar.prepare(inputs) for inputs in (fresh, read)]
    assert torch.equal(frames[0].shading.diffuse, frames[1].shading.diffuse)
    assert torch.equal(read.harmonics, before) and torch.equal(frames[1].incident.harmonics[skin], before[skin])
    assert not torch.equal(frames[1].incident.harmonics[~skin], before[~skin])


def test_where_all_texels_have_one_light_eyes_start_like_the_rest():
    """Lamps are far then; lids dim an eye's light as a whole, and what they hide at rest stays in the transfer."""
    atlas, far = walled_atlas(0.008, 0.03), HEAD | {"near_field": False, "transfer_start": "traced"}
    avatar = make_avatar(atlas, EYES, **far)
    eyeless = Avatar(atlas, texel_spacing(atlas), replace(avatar.spec, eyes=False))
    for name in ("transfer_color", "transfer_mono", "start_transfer_color"):
        assert torch.equal(getattr(avatar, name), getattr(eyeless, name))
    frames = [one.prepare(FrameInputs(atlas, make_frame(atlas, AHEAD, LIGHTS[:1]))) for one in (avatar, eyeless)]
    shown, bare = (frame.shading.diffuse.detach()[avatar.eyes.chosen] for frame in frames)
    assert torch.allclose(shown, frames[0].eyes.lids.opening[:, None] * bare, atol=1e-6) and bare.max() > 0.01
