"""The preset `papers_head`, element by element against the equations that RGCA prints."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.model import Avatar, Picture
from pipeline.avatar.networks.gaze_features import GazeFeatures
from pipeline.avatar.spec.planned import resolve_spec
from pipeline.avatar.spec.spec_words import describe
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.avatar.training.checkpoint import camera_view, load_avatar, save_avatar
from pipeline.avatar.training.head_losses import expression_terms
from pipeline.avatar.training.losses import reconstruction, regularization
from pipeline.avatar.training.step_loss import Portion, compute_loss
from pipeline.base.errors import InputError
from pipeline.config.effects import EFFECTS
from pipeline.config.train_avatar import TrainAvatar
from pipeline.geometry.texels import any_tangent, write_atlas
from tests.support.avatars import eyeballs, printed
from tests.support.avatars.printed import ROUNDING, assert_near, dense, leaky, numbers

SETTINGS = printed.preset("papers_head", code_size=4, decoder_channels=(8, 4), pose_points=4, eye_channels=(4,))
SKIN = np.array([[-0.08, -0.06, 0.05], [0.08, -0.06, 0.05], [0.08, 0.08, 0.05], [-0.08, 0.08, 0.05]])
LIGHTS, EYES = eyeballs.LIGHTS, eyeballs.EYES
INTENSITIES = np.full((len(LIGHTS), 3), 2.0)
LOOKS = eyeballs.gaze(15, -10)
MOST_GAIN, LARGEST_FACTOR = 3.0, 10.0


@cache
def scene():
    """An avatar of the preset with noise on all that it has, a moved head that smiles, and a camera."""
    atlas = eyeballs.make_atlas(48, (SKIN, np.array([[0, 1, 2], [0, 2, 3]])))
    spec = resolve_spec(SETTINGS, set(EFFECTS), "head")
    torch.manual_seed(0)
    avatar = Avatar(atlas, texel_spacing(atlas), spec, EYES)
    record = eyeballs.make_frame(atlas, LOOKS, LIGHTS, eyeballs.moved_head())
    away = (
        np.random.default_rng(0).normal(size=record.vertices.shape)
        * 1e-3
        * (np.arange(len(record.vertices)) > 1283)[:, None]
    )
    texture = np.random.default_rng(1).random((atlas.texel_count, 3)).astype(np.float32)
    record = replace(record, vertices=(record.vertices + away).astype(np.float32), texture=texture)
    inputs = FrameInputs(atlas, record)
    rest = torch.as_tensor(atlas.rest_vertices)
    avatar.networks.expression.learn_statistics([rest, inputs.local_vertices], [texture, texture**2])
    printed.shaken(avatar)
    camera = camera_view(eyeballs.make_image(eyeballs.CAMERA, eyeballs.MIDDLE, 8.0, 24))
    with torch.no_grad():
        return avatar, inputs, avatar.prepare(inputs), camera


def skin_alone(values):
    """Rows of texels that are no eye's."""
    chosen = numbers(scene()[0].eyes.chosen).astype(int)
    return np.delete(values if isinstance(values, np.ndarray) else numbers(values), chosen, 0)


def on_skin(found, expected, rounding=ROUNDING):
    assert_near(torch.as_tensor(skin_alone(found)), skin_alone(expected), rounding)


def head():
    """R and t, head from world."""
    motion = numbers(scene()[1].head_from_world)
    return motion[:, :3], motion[:, 3]


MOVED_ROUNDINGS = 4
"""Of a vertex that is turned and shifted in float32: three products and sums, and the shift. Over the scale of these
expressions, 30 um, they are a thousandth, so the encoder is held to the vertices that it gets."""


def test_3_expression_is_encoded_from_vertices_and_mean_texture():
    """Networks alone: no principal components."""
    avatar, inputs, _, _ = scene()
    encoder = avatar.networks.expression
    assert not encoder.components.any()
    R, t = head()
    local = numbers(inputs.local_vertices)
    moved = inputs.record.vertices.astype(np.float64) @ R.T + t
    assert np.abs(local - moved).max() <= MOVED_ROUNDINGS * 2**-24 * np.abs(moved).max()
    away = torch.as_tensor((local - numbers(encoder.middle)) / numbers(encoder.scale))
    points = dense(encoder.points, away[encoder.chosen].flatten())
    colors = (inputs.texture - encoder.texture_middle) / encoder.texture_scale
    features = leaky(torch.cat([points, encoder.texture(colors).double()]))
    found = avatar.networks.encode(inputs)
    assert_near(found.mean, numbers(dense(encoder.mean, features)))
    assert_near(found.log_variance, numbers(dense(encoder.log_variance, features)))


def gaze_map():
    """16 x 2 x 2 features per eye of its gaze, at the eye's place on the map of 8 x 8."""
    features = scene()[0].networks.gaze
    out = torch.zeros(16, 8, 8, dtype=torch.float64)
    for layer, (row, column) in zip(features.layers, features.places, strict=True):
        out[:, row : row + 2, column : column + 2] += dense(layer, torch.as_tensor(LOOKS)).reshape(16, 2, 2)
    return out


def code():
    avatar, inputs, _, _ = scene()
    return avatar.networks.encode(inputs).mean.detach().double()


def decoded_parameters():
    """What D_ci makes of code and gaze, as additions by parameter."""
    avatar = scene()[0]
    decoder, additions = avatar.networks.decoder.decoder, avatar.networks.decoder.additions
    first = torch.cat([dense(decoder.start, code()).reshape(-1, 8, 8), gaze_map()])
    parts = printed.decoded(decoder, avatar.atlas, first).split(additions.widths, -1)
    return {name: numbers(part) for name, part in zip(additions.shapes, parts, strict=True)}


def test_3_and_9_parameters_are_decoded_from_code_and_gaze():
    """Gaze comes in only where the eyes are on the map."""
    avatar, _, frame, _ = scene()
    own, spacing = avatar.shared().named(), float(avatar.spacing.mean())
    added = decoded_parameters()
    assert set(added) == set(own) == {
        "offset", "rotation", "log_scale", "opacity", "transfer_color", "transfer_mono", "normal_offset",
        "log_roughness",
    }  # fmt: skip
    for name, start in own.items():
        change = added[name].reshape(start.shape) * (spacing if name == "offset" else 1)
        if name in ("log_scale", "log_roughness"):  # no code makes them more than ten times larger
            change = np.log(LARGEST_FACTOR) * np.tanh(change / np.log(LARGEST_FACTOR))
        on_skin(getattr(frame.parameters, name), numbers(start) + change)
    empty = gaze_map().abs().sum(0) == 0
    assert empty.sum() >= 64 - 8 and not empty.all()
    elsewhere = FrameInputs(avatar.atlas, replace(scene()[1].record, gaze=np.tile(eyeballs.AHEAD, (2, 1)).astype("f4")))
    assert not torch.equal(
        avatar.networks.decode(avatar.shared(), elsewhere).parameters.opacity, frame.parameters.opacity
    )


def test_4_gaussians_sit_on_decoded_vertices_moved_and_turned_in_the_heads_frame():
    """t_k = v_k + dt_k and R_k, turned with the head alone."""
    avatar, _, frame, _ = scene()
    networks, atlas, (R, t) = avatar.networks, avatar.atlas, head()
    expression = networks.expression
    hidden = leaky(dense(expression.hidden, code()))
    vertices = numbers(expression.middle) + numbers(expression.scale) * numbers(dense(expression.last, hidden)).reshape(
        -1, 3
    )
    assert_near(frame.decoded.head.decoded_vertices, vertices)
    anchors = (vertices[atlas.corners] * atlas.barycentric[..., None]).sum(1)
    world = (anchors + numbers(frame.parameters.offset) - t) @ R
    on_skin(frame.gaussians.means, world)
    turned = R.T @ printed.rotations(numbers(frame.parameters.rotation))
    on_skin(frame.surface.axes, turned)
    on_skin(torch.as_tensor(printed.rotations(numbers(frame.gaussians.quaternions))), turned)


def light(points, R):
    """L_i of the lamps at points, in the head's frame."""
    out = 0.0
    for position, intensity in zip(LIGHTS, INTENSITIES, strict=True):
        away = position - points
        out = (
            out
            + printed.harmonics(printed.unit(away) @ R.T)[..., None]
            * (intensity / (away**2).sum(-1, keepdims=True))[:, None]
        )
    return out


def test_5_diffuse_colour_is_light_times_113_coefficients():
    """Coefficients are stored times 3.43, which is a choice of unit alone."""
    avatar, inputs, frame, _ = scene()
    color, mono = (numbers(d) / 3.43 for d in (frame.parameters.transfer_color, frame.parameters.transfer_mono))
    assert color.shape[1] * 3 + mono.shape[1] == 113
    d = np.concatenate([color, np.repeat(mono[..., None], 3, -1)], 1)
    arriving = light(numbers(inputs.posed.points), head()[0])
    on_skin(frame.shading.diffuse, numbers(avatar.albedo) * (arriving * d).sum(1), 5 * ROUNDING)


def viewed():
    """dv and dn of D_cv, which also sees the direction from the middle of the head to the camera."""
    avatar, _, _, camera = scene()
    networks, (R, t) = avatar.networks, head()
    toward = printed.unit(R @ numbers(camera.center) + t - numbers(networks.expression.middle).mean(0))
    view = dense(networks.direction, torch.as_tensor(toward))[:, None, None].expand(-1, 8, 8)
    first = torch.cat([dense(networks.view.start, code()).reshape(-1, 8, 8), gaze_map(), view])
    values = numbers(printed.decoded(networks.view, avatar.atlas, first))
    return values[:, 0], values[:, 1:]


def normals():
    frame = scene()[2]
    offset = numbers(frame.parameters.normal_offset) + viewed()[1]
    return printed.unit(numbers(frame.surface.posed.normals) + offset @ head()[0])


def test_9_normals_and_visibility_depend_on_the_view():
    """n = (n' + dn) / |n' + dn|, n' the normal of the coarse mesh."""
    avatar, _, frame, camera = scene()
    samples = avatar.samples(frame, avatar.viewed(frame, camera.center))
    on_skin(samples.normals, normals())
    on_skin(samples.visibility, 1 / (1 + np.exp(-numbers(avatar.visibility) - viewed()[0])))


def test_6_to_8_specular_colour_of_each_gaussian_without_fresnel():
    avatar, _, frame, camera = scene()
    samples = avatar.samples(frame, avatar.viewed(frame, camera.center))
    expected = printed.specular(
        numbers(frame.gaussians.means), normals(), np.exp(numbers(frame.parameters.log_roughness)),
        1 / (1 + np.exp(-numbers(avatar.visibility) - viewed()[0])), numbers(camera.center), LIGHTS, INTENSITIES,
    )  # fmt: skip
    found = avatar.layers(frame, camera.center).color - frame.shading.diffuse
    on_skin(found, expected, 1e-4)
    assert expected.max() > 0.1 and not avatar.built.specular.deferred and samples is not None


def test_2_a_pixel_blends_the_colours():
    """All Gaussians, also those that face away; beside the eyes, whose reflections are traced per pixel."""
    avatar, _, frame, camera = scene()
    layers = avatar.layers(frame, camera.center)
    axes = printed.rotations(numbers(frame.gaussians.quaternions))
    table = np.concatenate([numbers(layers.color), numbers(layers.mirrors)[:, :1]], 1)
    picture, alpha, _ = printed.blended(frame.gaussians, axes, table, camera, SETTINGS.dilation_px2)
    found, skin = avatar.view(frame, camera), picture[..., 3] < 1e-6
    assert_near(found.alpha, alpha)
    assert_near(found.rgb[torch.as_tensor(skin)], picture[skin][:, :3])
    assert 50 < skin.sum() < skin.size


def eye_map(number):
    """The 23 channels that an eye's decoders read: gaze, place and rotation of the head, open to the outside."""
    avatar, inputs, _, _ = scene()
    decoders, (R, t) = avatar.eyes.decoders, head()
    looks = leaky(dense(decoders.gaze[number], torch.as_tensor(LOOKS))).reshape(16, 4, 4)
    angle = np.arccos((np.trace(R.T) - 1) / 2)
    axis = np.array([R[1, 2] - R[2, 1], R[2, 0] - R[0, 2], R[0, 1] - R[1, 0]]) / (2 * np.sin(angle))
    pose = torch.as_tensor(np.concatenate([-R.T @ t, angle * axis]))[:, None, None].expand(-1, 4, 4)
    opening, cells = numbers(avatar.eyes.traced(inputs)[0].opening), numbers(decoders.cells[number]).astype(int)
    own = opening[numbers(decoders.rows[number]).astype(int)]
    mask = [own[cells == cell].mean() if (cells == cell).any() else 0.0 for cell in range(16)]
    return torch.cat([looks, pose, torch.tensor(mask).reshape(1, 4, 4)])


def eye_values(decoder, first, number):
    """A decoder's values at the texels of an eye, whose map is about its axis at rest."""
    avatar = scene()[0]
    x = first[None]
    for place, layer in enumerate(decoder.layers):
        x = x if place == 0 else leaky(x)
        x = torch.nn.functional.conv_transpose2d(x, layer.conv.weight.double(), stride=2, padding=1)
        x = x if layer.bias is None else x + layer.bias.double()
    rows = avatar.eyes.decoders.rows[number]
    direction = numbers(avatar.eyes.directions[rows])
    right = numbers(eye_right(numbers(avatar.eyes.axes[number])))
    down = np.cross(numbers(avatar.eyes.axes[number]), right)
    angle = np.arccos(np.clip(direction @ numbers(avatar.eyes.axes[number]), -1, 1))
    side = np.stack([direction @ right, direction @ down], -1)
    side = side / np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-12)
    place = torch.as_tensor(side * np.minimum(angle / (np.pi / 2), 1)[:, None])[None, None]
    at = torch.nn.functional.grid_sample(x, place, "bilinear", "border", align_corners=False)
    return numbers(at[0, :, 0].T)


def eye_right(axis):
    """The direction that is to the right on an eye's map; which one it is, is a choice."""
    return any_tangent(torch.as_tensor(axis, dtype=torch.float32)[None])[0]


def test_10_eyes_are_decoded_from_gaze_and_pose_of_the_head_and_view():
    avatar, inputs, frame, camera = scene()
    eyes, R = avatar.eyes, head()[0]
    seen = avatar.viewed(frame, camera.center)
    base = avatar.networks.decode(avatar.shared(), inputs).parameters
    for number in range(2):
        rows = eyes.decoders.rows[number]
        texels = eyes.chosen[rows]
        values = eye_values(eyes.decoders.fixed[number], eye_map(number), number)
        start = np.cumsum([0, *eyes.decoders.additions.widths])[list(eyes.decoders.additions.shapes).index("opacity")]
        assert_near(frame.parameters.opacity[texels], numbers(base.opacity[texels]) + values[:, start], 1e-4)
        centre = numbers(frame.eyes.centers[number])
        toward = R @ printed.unit(numbers(camera.center) - centre)
        view = leaky(dense(eyes.decoders.direction[number], torch.as_tensor(toward)))
        first = torch.cat([eye_map(number), view[:, None, None].expand(-1, 4, 4)])
        values = eye_values(eyes.decoders.viewed[number], first, number)
        assert_near(seen.eye_gain[rows], np.exp(MOST_GAIN * np.tanh(values[:, :3] / MOST_GAIN)), 1e-4)
        assert_near(seen.visibility[texels], viewed()[0][numbers(texels).astype(int)] + values[:, 3], 1e-4)
    assert set(eyes.decoders.additions.shapes) == {
        "rotation", "log_scale", "opacity", "transfer_color", "transfer_mono", "log_roughness"
    }  # fmt: skip
    assert frame.eyes.lids.skin is None and (frame.eyes.lids.opening == 1).all()


def test_11_and_12_reconstruction_and_divergence():
    avatar, inputs, frame, camera = scene()
    generator = torch.Generator().manual_seed(0)
    rgb, captured = (torch.rand(13, 15, 3, generator=generator) for _ in range(2))
    terms = reconstruction(Picture(rgb, torch.ones(13, 15)), captured, torch.ones(13, 15), camera, SETTINGS)
    terms |= expression_terms(avatar, frame, inputs, SETTINGS)
    assert_near(terms["photometric"], 10 * np.abs(numbers(rgb) - numbers(captured)).mean())
    latent = frame.decoded.head.latent
    mean, log_variance = numbers(latent.mean), numbers(latent.log_variance)
    assert_near(terms["kl"], 0.002 * 0.5 * (mean**2 + np.exp(log_variance) - log_variance - 1).mean())
    errors = numbers(frame.decoded.head.decoded_vertices) - numbers(inputs.local_vertices)
    assert_near(terms["geometry"], 10 * ((errors / numbers(avatar.networks.expression.scale)) ** 2).mean(), 1e-4)
    assert 0 < terms["ssim"] < 0.2 and terms.get("silhouette", torch.zeros(())) == 0


def test_13_to_16_regularisation():
    """In millimetres, and nothing else; the visibility of eyes, which is a camera's, with that camera's picture."""
    avatar, _, frame, camera = scene()
    scales, diffuse = 1e3 * numbers(frame.gaussians.scales), numbers(frame.shading.diffuse)
    of_eyes = numbers(avatar.eyes.chosen).astype(int)
    opacity = numbers(frame.gaussians.opacities)[of_eyes]
    expected = {
        "scale": 0.01 * printed.bound(scales, 0.1, 10.0),
        "negative": 0.01 * (np.minimum(diffuse, 0) ** 2).mean(),
        "eye_scale": 0.01 * (np.maximum(scales[of_eyes] - 0.1, 0) ** 2).mean(),
        "eye_opacity": 1e-4 * ((1 - opacity) ** 2).mean(),
    }
    found = regularization(avatar, frame, SETTINGS)
    assert {name for name, term in found.items() if term != 0} == set(expected)
    for name, value in expected.items():
        assert found[name].item() == pytest.approx(value, rel=1e-4), name
    picture, empty = avatar.view(frame, camera), torch.zeros(24, 24)
    seen = avatar.samples(frame, avatar.viewed(frame, camera.center)).visibility[avatar.eyes.chosen]
    terms = reconstruction(picture, torch.zeros(24, 24, 3), empty, camera, SETTINGS)
    assert_near(terms["eye_visibility"], 1e-4 * ((1 - numbers(seen)) ** 2).mean())


def test_every_part_learns_from_one_picture_and_every_slope_is_finite():
    avatar, inputs, _, _ = scene()
    image = eyeballs.make_image(eyeballs.CAMERA, eyeballs.MIDDLE, 8.0, 24)
    image = replace(image, image=np.full((24, 24, 3), 0.3, np.float32), mask=np.ones((24, 24), np.float32))
    terms = compute_loss(avatar, Portion(inputs, [image], 1), SETTINGS)
    sum(terms.values()).backward()
    for name, parameter in avatar.named_parameters():
        assert parameter.grad is not None and torch.isfinite(parameter.grad).all(), name
        assert parameter.grad.abs().max() > 0, name
    avatar.zero_grad()


def test_it_comes_back_from_its_files(tmp_path):
    avatar, inputs, frame, camera = scene()
    write_atlas(tmp_path / "atlas.safetensors", avatar.atlas)
    save_avatar(tmp_path / "avatar", avatar, {})
    loaded = load_avatar(tmp_path / "avatar", tmp_path / "atlas.safetensors").avatar
    with torch.no_grad():
        assert loaded.spec == avatar.spec
        assert torch.equal(loaded.view(loaded.prepare(inputs), camera).rgb, avatar.view(frame, camera).rgb)


def test_gaze_features_need_no_explicit_eyes_but_a_capture_that_declares_them():
    """RGCA's rows without the explicit eye model are told the gaze all the same."""
    without = SETTINGS.model_copy(update={"eyes": "off"})
    assert resolve_spec(without, {"eyes"}, "head").reads_eyes and not resolve_spec(without, {"eyes"}, "head").eyes
    assert not resolve_spec(SETTINGS, set(), "head").reads_eyes
    assert "gaze features" in describe(resolve_spec(without, {"eyes"}, "head"))
    with pytest.raises(InputError, match=r"gaze_features: expected eyes in eyes\.json, found none"):
        GazeFeatures(scene()[0].atlas, {})
    with pytest.raises(ValueError, match="lids: learned: expected eye_parameters: decoded"):
        TrainAvatar(lids="learned")


@pytest.mark.parametrize("row", ["eyenerf", "no_eyes_linear", "microfacet", "shadow_net", "rigid"])
def test_rows_of_the_papers_tables_can_be_built_on_the_preset(row):
    """`head_rows.yaml` before `papers_head.yaml`."""
    _, inputs, _, camera = scene()
    settings = TrainAvatar(**SETTINGS.model_dump() | printed.variants("head_rows")[row])
    avatar = Avatar(inputs.atlas, texel_spacing(inputs.atlas), resolve_spec(settings, set(EFFECTS), "head"), EYES)
    printed.shaken(avatar, 0.01)
    picture = avatar.view(avatar.prepare(inputs), camera)
    assert picture.rgb.isfinite().all() and picture.rgb.abs().max() > 0
    assert avatar.networks.gaze is not None
