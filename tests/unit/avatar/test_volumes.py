"""Volumes as an avatar's geometry: where boxes lie, what they show, that they learn, and what they cannot be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from pydantic import ValidationError

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.geometry.box_layout import REACH, lay_boxes
from pipeline.avatar.intrinsic_layers import intrinsic_layers
from pipeline.avatar.spec.planned import resolve_spec, unread_settings
from pipeline.avatar.spec.spec_words import describe
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.avatar.training.checkpoint import camera_view, load_avatar, save_avatar
from pipeline.avatar.training.losses import regularization
from pipeline.avatar.training.training import Training
from pipeline.base.errors import InputError
from pipeline.config.effects import EFFECTS
from pipeline.config.export_avatar import ExportAvatar
from pipeline.config.train_avatar import TrainAvatar
from pipeline.geometry.texels import write_atlas
from pipeline.stages import export_avatar, export_viewer
from tests.support.avatars import eyeballs
from tests.support.avatars.heads import ALBEDO, SETTINGS, folds, make_head
from tests.support.avatars.sheet import SIDE_M, make_image, make_sheet
from tests.support.viewer.ball_avatar import write_ball

SHEET = make_sheet(24)
VOXELS = 8
PATCH = 6
"""Texels along a side of a patch of boxes of 8 voxels: 8 / 1.36."""

FLOAT32 = 1e-6
ROWS = {
    "volumes_rgca": {},
    "volumes_eyenerf": {"highlight": "harmonics"},
    "volumes_linear": {"shading": "linear"},
    "deferred": {"deferred": "on"},
    "microfacet": {"shading": "microfacet", "visibility": "traced", "indirect": "bounce"},
    "shadow_net": {"shadow": "on", "shadow_width": 4},
}


def layout_of(atlas, voxels=VOXELS):
    return lay_boxes(atlas, texel_spacing(atlas).numpy(), voxels)


def test_boxes_of_a_flat_sheet_lie_on_its_squares():
    layout, texel = layout_of(SHEET), SIDE_M / 24
    assert len(layout.anchor) == (24 // PATCH) ** 2
    half = torch.tensor([PATCH * texel / 2 * REACH] * 2 + [PATCH * texel / 4])
    torch.testing.assert_close(layout.half_size, half.expand(16, 3).float(), atol=FLOAT32, rtol=0)
    points = SHEET.texel[:, ::-1] * (texel, -texel) + (-SIDE_M / 2 + texel / 2, SIDE_M / 2 - texel / 2)
    centers = points[layout.anchor] + layout.shift.numpy()[:, :2]
    middles = np.sort(np.unique(np.round(centers, 6)))
    np.testing.assert_allclose(middles, (np.arange(4) - 1.5) * PATCH * texel, atol=FLOAT32)
    # Columns show the texel that they stand on.
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, VOXELS)] * 2), -1) * layout.half_size[0, 0].item()
    away = np.abs(points[layout.texel] - (centers[:, None, None] + grid)).max(-1)
    inside = np.abs(centers[:, None, None] + grid).max(-1) < SIDE_M / 2
    assert away[inside].max() < texel / 2 + FLOAT32
    # A flat surface has layers where the voxels are.
    layer = (layout.lower - VOXELS * layout.texel[:, None]) + layout.share
    assert torch.allclose(layer, torch.arange(8.0)[None, :, None, None].expand_as(layer), atol=1e-4)
    assert layout.filled[:, :, torch.as_tensor(inside).all(0)].all()


def test_layers_of_a_sphere_are_spheres_across_its_seams():
    """Charts end somewhere on each ball; voxels know how high they are above it all the same."""
    atlas, radius = eyeballs.make_atlas(96), 0.012
    layout = layout_of(atlas)
    avatar = make_head(atlas, geometry="volumes")
    frame = avatar.prepare(FrameInputs(atlas, eyeballs.make_frame(atlas, eyeballs.AHEAD, eyeballs.LIGHTS)))
    boxes = frame.gaussians.volumes.map(torch.Tensor.detach)
    grid = torch.linspace(-1, 1, VOXELS)
    z, y, x = torch.meshgrid(grid, grid, grid, indexing="ij")
    local = torch.stack([x, y, z], -1) * boxes.half_sizes[:, None, None, None]
    places = boxes.centers[:, None, None, None] + torch.einsum("bij,bzyxj->bzyxi", boxes.rotations, local)
    middles = torch.tensor(np.array(list(eyeballs.CENTERS.values())), dtype=torch.float32)
    heights = (places[..., None, :] - middles).norm(dim=-1).amin(-1) - radius
    layer = (layout.lower - VOXELS * layout.texel[:, None]) + layout.share
    found = (layer - (VOXELS - 1) / 2) * layout.thickness_m
    near = layout.filled.bool() & (heights.abs() < layout.thickness_m)
    # Half a texel aside, 0.4 mm, on a sphere of 12 mm whose faces leave it by up to 0.1 mm.
    assert near.sum() > 1000
    assert (found - heights)[near].abs().max() < 5e-4
    assert len(layout.anchor) > 2 * (atlas.texel_count // PATCH**2) * 0.5


def test_untrained_boxes_close_the_surface_and_show_what_its_texels_radiate():
    frames = folds(SHEET)
    avatar = make_head(SHEET, frames, geometry="volumes", specular="off")
    frame = avatar.prepare(FrameInputs(SHEET, frames[0]))
    image = make_image(frames[0], ALBEDO, pixels=32)
    picture = avatar.view(frame, camera_view(image))
    inside = torch.as_tensor(image.mask) > 0
    inside[1:-1, 1:-1] &= inside[2:, 1:-1] & inside[:-2, 1:-1] & inside[1:-1, 2:] & inside[1:-1, :-2]
    assert (picture.alpha[inside] > 1 - 1e-5).all(), picture.alpha[inside].min()
    radiated = frame.shading.diffuse.detach()
    assert (picture.rgb[inside] > radiated.min() * (1 - 1e-5)).all()
    assert (picture.rgb[inside] < radiated.max() * (1 + 1e-5)).all()
    # As Gaussians show it: a texel, of 4 % of what the lamps change over the sheet, lies somewhere else.
    other = make_head(SHEET, frames, specular="off")
    shown = other.view(other.prepare(FrameInputs(SHEET, frames[0])), camera_view(image))
    color = (shown.rgb / shown.alpha[..., None].clamp_min(0.1))[inside]
    assert ((picture.rgb[inside] - color).abs().max() / color.abs().max()) < 0.05


@pytest.mark.parametrize("name", ROWS)
def test_every_appearance_learns_on_volumes(name):
    frames, settings = folds(SHEET), SETTINGS.model_copy(update={"geometry": "volumes", "steps": 8, **ROWS[name]})
    avatar = make_head(SHEET, frames, settings)
    start = {key: parameter.detach().clone() for key, parameter in avatar.named_parameters()}
    training = Training(avatar, settings, subject="sheet", images=3)
    inputs = [FrameInputs(SHEET, frame) for frame in frames]
    images = [make_image(frame, ALBEDO, 0.1) for frame in frames]
    terms = [training.take_step(step, inputs[step % 3], [images[step % 3]]) for step in range(7)]
    assert terms[6]["photometric"] < 0.9 * terms[0]["photometric"]
    assert {"offset", "volume", "kl", "geometry"} <= terms[0].keys() and not {"scale", "size"} & terms[0].keys()
    for key, parameter in avatar.named_parameters():
        assert torch.isfinite(parameter).all(), key
        if key in ("offset", "rotation", "log_scale", "opacity", "log_tint") or key.startswith("networks.places"):
            assert not torch.equal(parameter, start[key]), key


def test_stored_volumes_come_back_to_the_bit(tmp_path):
    frames = folds(SHEET)
    avatar = make_head(SHEET, frames, geometry="volumes")
    with torch.no_grad():
        for parameter in avatar.parameters():
            parameter += 0.01 * torch.randn_like(parameter)
    save_avatar(tmp_path, avatar, {})
    write_atlas(tmp_path / "atlas.safetensors", SHEET)
    again = load_avatar(tmp_path, tmp_path / "atlas.safetensors").avatar
    camera, inputs = camera_view(make_image(frames[1], ALBEDO, 0.1)), FrameInputs(SHEET, frames[1])
    one, other = (it.view(it.prepare(inputs), camera) for it in (avatar, again))
    assert torch.equal(one.rgb, other.rgb) and torch.equal(one.alpha, other.alpha)


def test_volume_prior_is_the_sum_of_products_of_half_sizes():
    frames = folds(SHEET)
    avatar = make_head(SHEET, frames, geometry="volumes")
    with torch.no_grad():
        avatar.log_scale[:] = torch.tensor([0.5, 0.25, 0.125]).log()
    terms = regularization(avatar, avatar.prepare(FrameInputs(SHEET, frames[0])), TrainAvatar(weight_volume=3.0))
    # 16 boxes, in units of a quarter of a metre; nothing is decoded yet.
    assert terms["volume"].item() == pytest.approx(3.0 * 16 * 2 * 1 * 0.5, rel=1e-5)


def test_intrinsic_layers_of_tinted_voxels_make_the_picture_up():
    frames = folds(SHEET)
    avatar = make_head(SHEET, frames, geometry="volumes", shading="microfacet", visibility="traced", indirect="bounce")
    plain = avatar.prepare(FrameInputs(SHEET, frames[0]))
    camera = camera_view(make_image(frames[0], ALBEDO, 0.1))
    with torch.no_grad():
        white = intrinsic_layers(avatar, plain, camera)
        avatar.log_tint += torch.tensor([0.5, 1.0, 2.0]).log()
        frame = avatar.prepare(FrameInputs(SHEET, frames[0]))
        rgb, layers = avatar.view(frame, camera).rgb, intrinsic_layers(avatar, frame, camera)
    total = layers.diffuse + layers.specular + (0 if layers.indirect is None else layers.indirect)
    torch.testing.assert_close(rgb, total, atol=1e-5, rtol=1e-4)
    for name in ("albedo", "diffuse"):
        tinted = getattr(white, name) * torch.tensor([0.5, 1.0, 2.0])
        torch.testing.assert_close(getattr(layers, name), tinted, atol=1e-6, rtol=1e-4)
    torch.testing.assert_close(layers.normal, white.normal, atol=1e-6, rtol=0)


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"eyes": "on"}, "geometry: volumes: expected eyes: off"),
        ({"texel_frame": "head"}, "geometry: volumes: expected texel_frame: tangent"),
        ({"depth": "median"}, "geometry: volumes: expected depth: traced"),
    ],
)
def test_settings_that_boxes_have_not_are_refused(asked, message):
    with pytest.raises(ValidationError, match=message):
        TrainAvatar(geometry="volumes", **asked)


def test_bodies_of_volumes_are_refused_and_eyes_left_out_of_heads():
    settings = TrainAvatar(geometry="volumes")
    with pytest.raises(InputError, match="expected head, found body, with geometry: volumes"):
        resolve_spec(settings, set(EFFECTS), "body")
    spec = resolve_spec(settings, set(EFFECTS), "head")
    assert spec.volumes and not spec.eyes and not spec.culls
    assert describe(spec).endswith("volumetric primitives")
    unread = unread_settings(settings.model_copy(update={"dilation_px2": 0.3, "ray_step_m": 0.01}), spec)
    assert unread == ["dilation_px2"]
    gaussians = resolve_spec(TrainAvatar(box_voxels=4), set(EFFECTS), "head")
    assert unread_settings(TrainAvatar(box_voxels=4), gaussians) == ["box_voxels"]


def test_splats_and_pages_of_volumes_are_refused(tmp_path):
    found = write_ball(tmp_path, geometry="volumes")
    with pytest.raises(InputError, match="geometry: expected gaussians, which a page can draw, found volumes"):
        export_viewer.run(**found, out=tmp_path / "index.html", subject="ball")
    files = {"cameras": tmp_path / "cameras.json", "index": tmp_path / "index"}
    with pytest.raises(InputError, match="geometry: expected gaussians for ply, spz, found volumes"):
        export_avatar.run(
            **found, **files, out=tmp_path / "export", settings=ExportAvatar(formats=("spz", "ply", "mesh"))
        )


def test_boxes_follow_what_is_tracked():
    """All moved by the same way, camera too: the same picture."""
    frames = folds(SHEET)
    avatar, image = make_head(SHEET, frames, geometry="volumes", anchors="tracked"), make_image(frames[0], ALBEDO)
    away = np.array([0.02, -0.03, 0.05])
    moved = replace(
        frames[0], vertices=(frames[0].vertices + away).astype(np.float32),
        light_positions=(frames[0].light_positions + away).astype(np.float32),
        head_from_world=np.concatenate([np.eye(3), -away[:, None]], 1).astype(np.float32),
    )  # fmt: skip
    there = replace(image, t=image.t - image.R @ away)
    one = avatar.view(avatar.prepare(FrameInputs(SHEET, frames[0])), camera_view(image))
    other = avatar.view(avatar.prepare(FrameInputs(SHEET, moved)), camera_view(there))
    # Rounding moves samples across faces, where a box has e^-8 of its density left.
    torch.testing.assert_close(one.rgb, other.rgb, atol=2e-3, rtol=0)
