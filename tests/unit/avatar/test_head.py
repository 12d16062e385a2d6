"""The avatar of a head: what its code knows, what each row builds, and that its training continues bit for bit."""

import dataclasses

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.frames.prepared import Latent
from pipeline.avatar.networks.expression_vae import Expression, standard_divergence
from pipeline.avatar.networks.head_networks import view_outputs
from pipeline.avatar.networks.light_linear import LightLinearDecoder
from pipeline.avatar.spec.planned import resolve_spec
from pipeline.avatar.training.checkpoint import LoadedAvatar, load_avatar, save_avatar
from pipeline.avatar.training.step_loss import drawn_expression
from pipeline.avatar.training.training import Position, Training
from pipeline.base.errors import InputError
from pipeline.config.train_avatar import TrainAvatar
from pipeline.geometry.texels import write_atlas
from tests.support.avatars.heads import ALBEDO, PLANNED, SETTINGS, folded, folds, make_head, trained
from tests.support.avatars.sheet import make_frame, make_image, make_sheet

FLOAT32_ROUNDING = 1e-5
"""What float32 leaves of numbers of about 1 after a hundred operations."""

ROWS = {
    "rgca": {},
    "eyenerf": {"highlight": "harmonics"},
    "linear": {"shading": "linear"},
    "no_mono_sh": {"transfer_degree": 3},
    "plain_normals": {"normals": "learned"},
    "mirror_lobe": {"highlight": "angular"},
    "cosine": {"highlight": "cosine"},
    "rigid": {"anchors": "rigid"},
    "tracked": {"anchors": "tracked"},
    "deferred": {"deferred": "on"},
    "shadow_net": {"shadow": "on", "shadow_width": 4},
}


@pytest.mark.parametrize("name", ROWS)
def test_every_row_learns_and_every_gradient_is_finite(name):
    atlas = make_sheet(16)
    frames = folds(atlas)
    new, avatar = make_head(atlas, frames, **ROWS[name]), trained(atlas, frames, **ROWS[name])
    # Rigid tracking sees no vertices move, and decodes none.
    unused = {f"networks.expression.{part}" for part in ("points", "hidden", "last")} if name == "rigid" else set()
    for key, parameter in avatar.named_parameters():
        assert torch.isfinite(parameter).all() and torch.isfinite(parameter.grad).all(), key
        if not any(key.startswith(part) for part in unused):
            assert not torch.equal(parameter, new.get_parameter(key)), key
    image = make_image(frames[0], ALBEDO, 0.1)
    before, after = (LoadedAvatar(it, atlas).render(frames[0], image)[0].numpy() for it in (new, avatar))
    assert np.abs(after - image.image).mean() < np.abs(before - image.image).mean()


def test_rows_build_what_they_say_and_nothing_else():
    atlas = make_sheet(8)

    def built(**row):
        avatar = make_head(atlas, **row)
        return {name for name, _ in avatar.named_parameters() if "." not in name}, view_outputs(avatar.spec)

    full, outputs = built()
    assert outputs == {"visibility": 1, "normal_offset": 3}
    lobe = {"log_roughness", "visibility", "normal_offset"}
    assert built(highlight="harmonics") == (full - lobe, {"specular_harmonics": 81})
    assert built(shading="linear") == (full - lobe - {"transfer_mono"}, {})
    assert built(transfer_degree=3) == (full - {"transfer_mono"}, outputs)
    assert built(normals="learned") == (full, {"visibility": 1})
    assert built(normals="mesh") == (full - {"normal_offset"}, {"visibility": 1})
    assert built(highlight="cosine") == (full, outputs)


def test_the_kind_of_the_capture_decides_and_bodies_stay_as_they_were():
    for settings in (TrainAvatar(shading="transfer"), TrainAvatar(avatar="body", shading="transfer")):
        assert resolve_spec(settings, PLANNED).shading == "transfer"
        assert resolve_spec(settings, PLANNED).normals == "learned"
    auto = resolve_spec(TrainAvatar(shading="transfer"), PLANNED, "head")
    assert (auto.head, auto.shading, auto.shadow, auto.normals) == (True, "harmonics", False, "viewed")
    assert not resolve_spec(TrainAvatar(avatar="body"), PLANNED, "head").head
    assert TrainAvatar().reads_textures("head") and not TrainAvatar().reads_textures("body")
    learned = PLANNED | {"learned_transport"}
    papers = TrainAvatar(shading="transfer")
    assert not papers.reads_irradiance(learned, "head") and papers.reads_irradiance(learned)
    for wrong in ({"shading": "linear"}, {"highlight": "harmonics"}, {"normals": "viewed"}):
        with pytest.raises(InputError, match="which only heads have"):
            resolve_spec(TrainAvatar(**wrong), PLANNED)


def test_a_new_head_on_its_tracked_vertices_is_the_body_with_unturned_harmonics():
    atlas = make_sheet(16)
    frame = folded(atlas, 0.1)
    image = make_image(frame, ALBEDO, 0.1)
    body = {"avatar": "body", "shading": "harmonics", "shadow": "off", "highlight": "half"}
    pictures = [
        LoadedAvatar(make_head(atlas, [frame], **row), atlas).render(frame, image)[0]
        for row in ({"anchors": "tracked"}, body)
    ]
    assert pictures[0].abs().sum() > 0
    assert torch.equal(*pictures)


def test_codes_of_planted_expressions_come_back_also_of_mixtures_never_seen():
    """Two ways to move, filmed one at a time: vertices are decoded to rounding, and so are both together."""
    atlas = make_sheet(8)
    avatar = make_head(atlas)
    rest, generator = torch.as_tensor(atlas.rest_vertices), torch.Generator().manual_seed(0)
    ways = torch.randn(2, *rest.shape, generator=generator) * 0.01
    expression = avatar.networks.expression
    expression.learn_statistics([rest + amount * way for way in ways for amount in (-1.0, 0.3, 1.0)], [])
    for weights in ((1.0, 0.0), (0.0, -1.0), (0.7, 0.9), (3.0, -2.0)):
        shape = rest + sum(weight * way for weight, way in zip(weights, ways, strict=True))
        decoded = expression.vertices(expression.encode(shape).mean)
        assert (decoded - shape).abs().max() < 1e-5 * 0.4  # of the sheet's size
    assert (expression.components[2:] == 0).all()  # two ways to move need two numbers


def test_expressions_that_are_all_alike_are_no_division_by_zero():
    atlas = make_sheet(8)
    expression = make_head(atlas).networks.expression
    rest = torch.as_tensor(atlas.rest_vertices)
    expression.learn_statistics([rest, rest], [np.ones((64, 3), np.float32)] * 2)
    latent = expression.encode(rest, torch.ones(64, 3))
    assert torch.isfinite(latent.mean).all() and torch.isfinite(latent.log_variance).all()
    assert torch.equal(expression.vertices(latent.mean), rest)


def test_divergence_is_zero_for_a_standard_normal_and_what_sampling_says_elsewhere():
    assert standard_divergence(Latent(torch.zeros(3), torch.zeros(3))) == 0
    latent = Latent(torch.tensor([0.5, -1.0]).double(), torch.tensor([-1.0, 0.7]).double())
    z = latent.sample(torch.randn(200_000, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64))
    normal = torch.distributions.Normal
    gain = normal(latent.mean, (latent.log_variance / 2).exp()).log_prob(z) - normal(0.0, 1.0).log_prob(z)
    error = gain.mean(1).std() / len(z) ** 0.5
    assert abs(gain.mean() - standard_divergence(latent)) < 4 * error


def test_what_a_step_draws_depends_on_subject_and_step_alone():
    avatar = make_head(make_sheet(8))
    draws = [drawn_expression(avatar, *parts)["noise"] for parts in (("a", 1), ("a", 1), ("a", 2), ("b", 1))]
    assert torch.equal(draws[0], draws[1])
    assert not torch.equal(draws[0], draws[2]) and not torch.equal(draws[0], draws[3])
    assert drawn_expression(make_head(make_sheet(8), avatar="body"), "a", 1) == {}


def test_continued_training_is_bitwise_the_same(tmp_path):
    atlas = make_sheet(16)
    frames = folds(atlas)
    inputs, images = [FrameInputs(atlas, frame) for frame in frames], [make_image(f, ALBEDO, 0.1) for f in frames]

    def run(first, last, start=None):
        avatar = make_head(atlas, frames)
        training = Training(avatar, SETTINGS, subject="sheet")
        if start:
            assert training.restore(start, "same").step == first
        for step in range(first, last):
            training.take_step(step, inputs[step % 3], [images[step % 3]])
        training.save(tmp_path / f"{last}.safetensors", Position(last), "same")
        return avatar.state_dict()

    whole = run(0, 6)
    run(0, 2)
    continued = run(2, 6, tmp_path / "2.safetensors")
    for name, tensor in whole.items():
        assert torch.equal(tensor, continued[name]), name


def test_pictures_are_of_the_mean_code_and_come_back_from_files(tmp_path):
    atlas = make_sheet(8)
    frames = folds(atlas)
    avatar = trained(atlas, frames)
    write_atlas(tmp_path / "atlas.safetensors", atlas)
    save_avatar(tmp_path / "avatar", avatar, {})
    loaded = load_avatar(tmp_path / "avatar", tmp_path / "atlas.safetensors")
    image = make_image(frames[1], ALBEDO, 0.1)
    pictures = [it.render(frames[1], image)[0] for it in (loaded, LoadedAvatar(avatar, atlas))]
    assert loaded.avatar.spec == avatar.spec and torch.equal(*pictures)
    inputs = FrameInputs(atlas, frames[1])
    frame, mean = avatar.prepare(inputs), avatar.networks.encode(inputs).mean
    assert torch.equal(frame.decoded.head.code, mean)
    assert torch.equal(avatar.prepare(inputs, code=mean).gaussians.means, frame.gaussians.means)
    noise = torch.ones(4)
    assert not torch.equal(avatar.prepare(inputs, noise=noise).gaussians.means, frame.gaussians.means)


def test_a_head_knows_no_place_in_the_world():
    """Head, camera and lamps moved together: what each texel is and shows stays."""
    atlas = make_sheet(8)
    frames = folds(atlas)
    avatar, frame = trained(atlas, frames), frames[1]
    turn, shift = Rotation.from_euler("xyz", [0.4, 1.1, -0.6]), np.array([0.3, -0.2, 0.5])
    back = np.concatenate([turn.inv().as_matrix(), -turn.inv().apply(shift)[:, None]], 1)
    moved = dataclasses.replace(
        frame,
        vertices=(turn.apply(frame.vertices) + shift).astype(np.float32),
        light_positions=(turn.apply(frame.light_positions) + shift).astype(np.float32),
        head_from_world=back.astype(np.float32),
    )
    center = np.array([0.1, 0.2, 1.0])
    here, there = (avatar.prepare(FrameInputs(atlas, record)) for record in (frame, moved))
    seen = [
        avatar.viewed(prepared, torch.tensor(place, dtype=torch.float32))
        for prepared, place in ((here, center), (there, turn.apply(center) + shift))
    ]
    for name in ("visibility", "normal_offset"):
        assert (getattr(seen[0], name) - getattr(seen[1], name)).abs().max() < FLOAT32_ROUNDING, name
    for name in ("log_scale", "transfer_color", "offset"):
        difference = getattr(here.parameters, name) - getattr(there.parameters, name)
        assert difference.abs().max() < FLOAT32_ROUNDING, name
    assert (here.shading.diffuse - there.shading.diffuse).abs().max() < FLOAT32_ROUNDING
    assert (here.decoded.head.code - there.decoded.head.code).abs().max() < FLOAT32_ROUNDING
    elsewhere = avatar.viewed(here, torch.tensor([-1.0, 0.0, 0.3]))
    assert (seen[0].normal_offset - elsewhere.normal_offset).abs().max() > 0  # and yet it depends on the view


def test_without_a_motion_the_rigid_one_is_found():
    atlas = make_sheet(8)
    frame = make_frame(atlas, np.array([[0.5, 0.3, 1.5]]), np.full((1, 3), 3.0))
    turn, shift = Rotation.from_euler("xyz", [0.4, 1.1, -0.6]), np.array([0.3, -0.2, 0.5])
    posed = dataclasses.replace(frame, vertices=(turn.apply(frame.vertices) + shift).astype(np.float32))
    assert np.abs(FrameInputs(atlas, posed).local_vertices.numpy() - frame.vertices).max() < FLOAT32_ROUNDING


def test_linear_row_is_linear_in_the_light():
    atlas = make_sheet(8)
    torch.manual_seed(0)
    decoder = LightLinearDecoder(atlas, 4, (8, 4), beside=2)
    torch.nn.init.ones_(decoder.carried[-1].conv.parametrizations.weight.original0)
    code, beside, lights = torch.randn(4), torch.randn(2, 8, 8), torch.randn(2, 81, 3)
    both = decoder(code, beside, lights[0] + 2 * lights[1])
    apart = decoder(code, beside, lights[0]) + 2 * decoder(code, beside, lights[1])
    assert both.abs().max() > 0.01
    assert (both - apart).abs().max() < FLOAT32_ROUNDING * both.abs().max()
    white, thrice = lights[:1, :, :1], lights[0, :, :1].expand(-1, 3).contiguous()
    assert torch.allclose(decoder(code, beside, white[0]), decoder(code, beside, thrice), rtol=1e-4, atol=1e-5)
    red = thrice * torch.tensor([1.0, 0.0, 0.0])
    assert (decoder(code, beside, red)[:, 1:] == 0).all()  # red light makes nothing green


def test_encoder_without_textures_takes_vertices_alone():
    atlas = make_sheet(8)
    spec = make_head(atlas).spec
    torch.manual_seed(0)
    expression = Expression(atlas, spec)
    vertices = torch.as_tensor(folded(atlas, 0.1).vertices)
    average = expression.encode(vertices, expression.texture_middle)
    assert torch.equal(expression.encode(vertices).mean, average.mean)
