"""The preset `papers_body`, element by element against the equations that RFGCA prints."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.model import Avatar, Picture
from pipeline.avatar.spec.planned import resolve_spec
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.avatar.training.checkpoint import camera_view
from pipeline.avatar.training.losses import dropped_terms, reconstruction, regularization
from pipeline.config.effects import EFFECTS
from pipeline.config.trace_irradiance import TraceIrradiance
from pipeline.lighting.frame_irradiance import FrameTracer, StageLights
from tests.support.avatars import printed
from tests.support.avatars.printed import ROUNDING, assert_near, dense, leaky, numbers
from tests.support.avatars.sheet import make_frame, make_image, make_sheet

SETTINGS = printed.preset(
    "papers_body", code_size=4, decoder_channels=(8, 4), pose_points=4, shadow_width=4, shadow_levels=1
)
ATLAS = make_sheet(8)
LIGHTS = np.array([[0.5, 0.3, 1.5], [-0.6, 0.0, 1.2], [0.0, 0.1, 1.0]])
INTENSITIES = np.array([[3.0, 2.0, 1.0], [1.0, 2.0, 3.0], [2.0, 2.0, 2.0]])


@cache
def scene():
    """An avatar of the preset with noise on all that it has, a bent sheet as its frame, and a camera."""
    spec = resolve_spec(SETTINGS, set(EFFECTS) - {"eyes"})
    torch.manual_seed(0)
    avatar = printed.shaken(Avatar(ATLAS, texel_spacing(ATLAS), spec))
    record = make_frame(ATLAS, LIGHTS, INTENSITIES)
    share = np.random.default_rng(0).random(ATLAS.texel_count).astype(np.float32)
    bent = record.vertices + np.array([[0, 0, 0], [0, 0, 0.1], [0, 0, 0], [0, 0, 0]], np.float32)
    inputs = FrameInputs(ATLAS, replace(record, vertices=bent, irradiance=share, cosine_visibility=share**2))
    camera = camera_view(make_image(record, np.ones(3), 0.1, pixels=16))
    with torch.no_grad():
        return avatar, inputs, avatar.prepare(inputs), camera


def code_and_parameters():
    avatar, inputs, frame, _ = scene()
    rest, posed = (
        points.astype(np.float64) - points.mean(0) for points in (ATLAS.rest_vertices, inputs.record.vertices)
    )
    u, _, v = np.linalg.svd(posed.T @ rest)
    turn = u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v  # the root's: of all points together (Kabsch 1976)
    extent = np.sqrt((rest**2).sum(1).mean())
    encoder = avatar.networks.code.parts["body"]
    moved = ((posed @ turn - rest) / extent)[encoder.chosen.numpy()]
    hidden = leaky(dense(encoder.hidden, torch.as_tensor(moved.ravel())))
    return leaky(dense(encoder.last, hidden)), frame.parameters


def test_3_points_moved_back_by_the_root_are_encoded():
    avatar, inputs, _, _ = scene()
    assert_near(avatar.networks.code(inputs.record.vertices), numbers(code_and_parameters()[0]))


def test_4_geometry_and_transfer_are_decoded_from_the_code():
    """A texel's own parameters are the untied bias of the decoder's last layer."""
    avatar = scene()[0]
    code, parameters = code_and_parameters()
    decoder, additions = avatar.networks.pose.decoder, avatar.networks.pose.additions
    own = avatar.shared().named(additions.shapes)
    first = dense(decoder.start, code).reshape(-1, 8, 8)
    parts = printed.decoded(decoder, ATLAS, first).split(additions.widths, -1)
    for (name, start), part in zip(own.items(), parts, strict=True):
        unit = float(avatar.spacing.mean()) if name == "offset" else 1.0
        assert_near(getattr(parameters, name), numbers(start) + unit * numbers(part).reshape(start.shape))
    assert set(own) == {
        "offset", "rotation", "log_scale", "opacity", "transfer_color", "transfer_mono", "normal_offset"
    }  # fmt: skip


def axes_of(frame):
    return numbers(frame.surface.posed.tangent_frames) @ printed.rotations(numbers(frame.parameters.rotation))


def test_5_and_6_places_and_rotations():
    frame = scene()[2]
    posed, tangent_frames = frame.surface.posed, numbers(frame.surface.posed.tangent_frames)
    offsets = np.einsum("kij,kj->ki", tangent_frames, numbers(frame.parameters.offset))
    assert_near(frame.gaussians.means, numbers(posed.points) + offsets)
    assert_near(frame.surface.axes, axes_of(frame))
    assert_near(torch.as_tensor(printed.rotations(numbers(frame.gaussians.quaternions))), axes_of(frame))


def test_7_to_9_diffuse_colour_is_light_times_three_zonal_lobes():
    """sum_i L_i d_i, with L_i and d_i in spherical harmonics; degrees 4 to 8 monochrome."""
    avatar, _, frame, _ = scene()
    means, axes, albedo = numbers(frame.gaussians.means), axes_of(frame), numbers(avatar.albedo)
    color, mono = (numbers(z) for z in (frame.parameters.transfer_color, frame.parameters.transfer_mono))
    coefficients = np.concatenate([color, np.repeat(mono[..., None], 3, -1)], 2)  # axis, degree, colour
    degree = np.repeat(np.arange(9), 2 * np.arange(9) + 1)
    d = sum(coefficients[:, a, degree] * printed.harmonics(axes[:, :, a])[..., None] for a in range(3))
    light = 0.0
    for position, intensity in zip(LIGHTS, INTENSITIES, strict=True):
        away = position - means
        distance2 = (away**2).sum(-1)
        light = light + printed.harmonics(printed.unit(away))[..., None] * (intensity / distance2[:, None])[:, None]
    assert_near(frame.shading.diffuse, albedo * (light * d).sum(1), 5 * ROUNDING)


def test_10_normals_bend_from_the_last_column():
    frame = scene()[2]
    axes = axes_of(frame)
    bent = axes[..., 2] + np.einsum("kij,kj->ki", axes, numbers(frame.parameters.normal_offset))
    assert_near(frame.surface.bent_normals, printed.unit(bent))


def visibility():
    """v_k = D_cv(l_b, w_o), w_o in the frame of each Gaussian."""
    avatar, _, frame, camera = scene()
    view = avatar.networks.view
    shared = printed.decoded(
        view.decoder, ATLAS, dense(view.decoder.start, code_and_parameters()[0]).reshape(-1, 8, 8)
    )  # fmt: skip
    toward = printed.unit(numbers(camera.center) - numbers(frame.gaussians.means))
    local = torch.as_tensor(np.einsum("kij,ki->kj", axes_of(frame), toward))
    hidden = leaky(torch.cat([leaky(shared), local], -1) @ view.hidden.weight.double().T + view.hidden.bias.double())
    added = (hidden @ view.last.weight.double().T + view.last.bias.double())[:, 0]
    return 1 / (1 + np.exp(-numbers(avatar.visibility) - numbers(added)))


def test_14_visibility_is_decoded_for_each_view():
    avatar, _, frame, camera = scene()
    assert_near(avatar.built.specular.visibility(avatar.viewed(frame, camera.center)), visibility())


def shaded_sheet():
    """The sheet with a smaller one 0.2 m above a part of it, which no texel lies on."""
    roof = np.array([[0.0, -0.1, 0.2], [0.3, -0.1, 0.2], [0.3, 0.2, 0.2], [0.0, 0.2, 0.2]], np.float32)
    faces = np.concatenate([ATLAS.faces, np.array([[4, 5, 6], [4, 6, 7]], np.int32)])
    uv = np.concatenate([ATLAS.uv, np.zeros((2, 3, 2), np.float32)])
    vertices = np.concatenate([ATLAS.rest_vertices, roof])
    return replace(ATLAS, faces=faces, uv=uv, weld=np.arange(8, dtype=np.int32), rest_vertices=vertices)


def arriving():
    """L_j Vis_j and L_j at every texel, L_j = I_j / d_j^2; a roof of z = 0.2 m over [0, 0.3] x [-0.1, 0.2] hides."""
    atlas = shaded_sheet()
    points = (atlas.rest_vertices[atlas.corners].astype(np.float64) * atlas.barycentric[..., None]).sum(1)
    away = LIGHTS[:, None] - points
    sent = (INTENSITIES @ [0.2126, 0.7152, 0.0722])[:, None] / (away**2).sum(-1)
    at_roof = points + away * (0.2 / away[..., 2:])
    hidden = (np.abs(at_roof[..., 0] - 0.15) < 0.15) & (np.abs(at_roof[..., 1] - 0.05) < 0.15)
    return sent * ~hidden, sent


def traced(**changes):
    settings = TraceIrradiance(**printed.section("papers_body", "trace_irradiance") | changes)
    stage = StageLights(LIGHTS, {0: INTENSITIES @ [0.2126, 0.7152, 0.0722]}, False)
    atlas = shaded_sheet()
    return FrameTracer(atlas, stage, settings).trace(0, atlas.rest_vertices, np.random.default_rng(0)).values


def test_15_irradiance_is_the_share_of_the_light_that_arrives():
    came, sent = arriving()
    assert_near(torch.as_tensor(traced()), came.sum(0) / sent.sum(0))
    assert 0.1 < (came < sent).mean() < 0.9


def test_15_by_one_drawn_light_of_equal_chances_as_a3_has_it():
    """Each texel has one of M L_j Vis_j / sum_j L_j, all of them somewhere, and their mean is the exact one's."""
    came, sent = arriving()
    row = printed.variants("ablations")["irradiance_1spp"]["trace_irradiance"]
    values = traced(**row)
    possible = len(LIGHTS) * came / sent.sum(0)
    off = np.abs(values - possible)
    assert off.min(0).max() < 1e-5
    assert set(off.argmin(0)) == {0, 1, 2}
    error = (possible.std(0) / np.sqrt(len(values))).mean()
    assert abs(values.mean() - (came.sum(0) / sent.sum(0)).mean()) < 4 * error


def test_16_shadow_is_a_network_of_the_irradiance_alone():
    avatar, inputs, frame, _ = scene()
    net, shadow = avatar.shadow_net, frame.shading.shadow
    with torch.no_grad():
        reference = type(net)(ATLAS, 4, "irradiance", 1).double()
        reference.load_state_dict(net.state_dict())
    conv = torch.nn.functional.conv2d

    def layer(x, conv_layer):
        return leaky(conv(x, conv_layer.weight, conv_layer.bias, padding=1))

    x = torch.as_tensor(inputs.record.irradiance.astype(np.float64)).reshape(1, 1, 8, 8)
    x = layer(x, reference.hidden[0])
    coarse = layer(torch.nn.functional.avg_pool2d(x, 2), reference.coarser[0])
    x = x + torch.nn.functional.interpolate(coarse, (8, 8), mode="bilinear", align_corners=False)
    x = conv(layer(x, reference.hidden[1]), reference.last.weight, reference.last.bias, padding=1)
    assert_near(shadow, numbers(torch.sigmoid(x)).ravel())
    other = net(inputs.irradiance[0], torch.zeros(ATLAS.texel_count))
    assert torch.equal(shadow, other)  # the cosine visibility is not read


def test_2_and_11_to_13_and_16_a_pixel():
    """C = (c_d + c_s) shadow; normals, roughness, visibility and shadow as Eq. 2 accumulates them; no Fresnel."""
    avatar, _, frame, camera = scene()
    values = [frame.shading.diffuse, frame.surface.bent_normals, frame.parameters.log_roughness.exp()[:, None]]
    table = np.concatenate([*map(numbers, values), visibility()[:, None], numbers(frame.shading.shadow)[:, None]], 1)
    picture, alpha, depth = printed.blended(frame.gaussians, axes_of(frame), table, camera, SETTINGS.dilation_px2)
    row, column = np.nonzero(alpha > 1 / 255)
    pixels, found = picture[row, column], avatar.view(frame, camera)
    points = printed.points_of(row, column, depth[row, column] / alpha[row, column], camera)
    shine = printed.specular(
        points,
        printed.unit(pixels[:, 3:6]),
        np.maximum(pixels[:, 6], 1e-3),
        pixels[:, 7],
        numbers(camera.center),
        LIGHTS,
        INTENSITIES,
    )
    assert_near(found.rgb[row, column], (pixels[:, :3] + shine) * pixels[:, 8:], 2e-4)
    assert_near(found.alpha, alpha)
    assert shine.max() > 0.01 and pixels[:, 8].min() < 0.3  # a highlight, and pixels that are covered in part


def test_17_reconstruction_is_the_mean_absolute_error_and_a_dropped_term_is_told():
    generator = torch.Generator().manual_seed(0)
    rgb, captured = (torch.rand(6, 5, 3, generator=generator) for _ in range(2))
    alpha, mask = torch.rand(6, 5, generator=generator), torch.ones(6, 5)
    terms = reconstruction(Picture(rgb, alpha), captured, mask, scene()[3], SETTINGS)
    assert_near(terms["photometric"], np.abs(numbers(rgb) - numbers(captured)).mean())
    assert_near(terms["silhouette"], 0.1 * np.abs(numbers(alpha) - 1).mean())
    assert_near(terms["alpha_sparsity"], 0.1 * np.minimum(numbers(alpha), 1 - numbers(alpha)).mean())
    assert "lpips" not in terms and "weight_lpips is 0.1" in dropped_terms(SETTINGS)["lpips"]
    assert not dropped_terms(SETTINGS.model_copy(update={"weight_lpips": 0.0}))


@pytest.mark.parametrize("step", [0, 20])
def test_18_regularisation_as_appendix_b_defines_it(step):
    avatar, _, frame, _ = scene()
    scales, albedo = numbers(frame.gaussians.scales), numbers(avatar.albedo)
    diffuse, width = numbers(frame.shading.diffuse), np.exp(numbers(frame.parameters.log_roughness))
    expected = {
        "scale": 0.01 * printed.bound(scales, 1e-4, 1e-2),
        "roughness": 0.01 * printed.bound(width, 0.01, 0.25),
        "size": np.abs(scales).mean(),
        "offset": 0.05 * (numbers(frame.parameters.offset) ** 2).mean(),
        "normal": (1 - step / SETTINGS.normal_steps) * (numbers(frame.parameters.normal_offset) ** 2).mean(),
        "albedo": 0.01 * np.abs(albedo).mean(),
        "negative": 0.01 * ((np.minimum(diffuse, 0) ** 2).mean() + (np.minimum(albedo, 0) ** 2).mean()),
    }
    found = regularization(avatar, frame, SETTINGS, step)
    assert {name for name, term in found.items() if term != 0} == set(expected)
    for name, value in expected.items():
        assert found[name].item() == pytest.approx(value, rel=1e-4), name
