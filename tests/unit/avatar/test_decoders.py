"""Networks of pose and view: they start as nothing, follow poses they have not seen, and know no place in the world."""

import dataclasses

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.model import Avatar
from pipeline.avatar.networks.decoders import AtlasDecoder, PoseDecoder, bilinear
from pipeline.avatar.networks.pose_encoder import PoseCode
from pipeline.avatar.networks.pose_points import body_points, face_points, pose_offsets
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.spec.planned import resolve_spec
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.avatar.training.checkpoint import LoadedAvatar, load_avatar, save_avatar
from pipeline.avatar.training.training import Training
from pipeline.base.errors import InputError
from pipeline.config.train_avatar import TrainAvatar
from pipeline.geometry.texels import write_atlas
from tests.support.avatars.sheet import make_frame, make_image, make_sheet

SMALL = {"code_size": 8, "decoder_channels": (8, 4), "pose_points": 4}
DECODED = TrainAvatar(shading="transfer", deferred="on", steps=4, parameters="decoded", shadow_width=4, **SMALL)
PLANNED = {"shadow", "articulation", "near_field", "specular", "deferred"}
ALBEDO = np.array([0.7, 0.4, 0.2])
FLOAT32_ROUNDING = 1e-5
"""What float32 leaves of numbers of about 1 after a hundred operations."""


def folded(atlas, fold, number=0):
    """The sheet with one corner lifted by `fold` metres, under two lamps."""
    frame = make_frame(atlas, np.array([[0.5, 0.3, 1.5], [-0.6, 0.0, 1.2]]), np.full((2, 3), 3.0), number)
    vertices = frame.vertices.copy()
    vertices[1, 2] += fold
    return dataclasses.replace(frame, vertices=vertices)


def make_avatar(atlas, settings, planned=PLANNED):
    torch.manual_seed(0)
    return Avatar(atlas, texel_spacing(atlas), resolve_spec(settings, planned))


def trained(atlas, frames, steps=3):
    avatar = make_avatar(atlas, DECODED)
    training, inputs = Training(avatar, DECODED, images=len(frames)), [FrameInputs(atlas, frame) for frame in frames]
    images = [make_image(frame, ALBEDO, 0.1) for frame in frames]
    for step in range(steps):
        chosen = step % len(frames)
        training.take_step(step, inputs[chosen], [images[chosen]])
    return avatar


@pytest.mark.parametrize("deferred", [True, False])
def test_a_new_avatar_with_networks_is_the_avatar_without_bit_for_bit(deferred):
    atlas = make_sheet(16)
    frame = folded(atlas, 0.1)
    image = make_image(frame, ALBEDO, 0.1)
    pictures = []
    for parameters in ("texels", "decoded"):
        changes = {"parameters": parameters, "deferred": "on" if deferred else "off"}
        avatar = make_avatar(atlas, DECODED.model_copy(update=changes))
        pictures.append(LoadedAvatar(avatar, atlas).render(frame, image))
    for without, with_networks in zip(*pictures, strict=True):
        assert torch.equal(without, with_networks)
        assert without.abs().sum() > 0


def test_only_what_the_plan_asks_for_is_built():
    atlas = make_sheet(8)

    def networks(planned, **choices):
        avatar = make_avatar(atlas, DECODED.model_copy(update=choices), planned)
        return {name.split(".")[1] for name, _ in avatar.named_parameters() if name.startswith("networks.")}

    assert networks(PLANNED) == {"code", "pose", "view"}
    assert networks(PLANNED, parameters="texels") == set()
    assert networks(PLANNED, specular="off") == {"code", "pose"}
    assert networks({"shadow", "specular"}) == {"view"}  # without articulation there is no pose to encode
    assert networks({"shadow", "specular"}, specular="off") == set()
    assert networks({"shadow", "specular"}, face=(0.0, 0.0, 0.0, 1.0)) == {"code", "pose", "view"}


def test_every_network_learns_and_every_gradient_is_finite():
    atlas = make_sheet(8)
    frames = [folded(atlas, 0.0, 0), folded(atlas, 0.1, 1)]
    avatar = trained(atlas, frames)
    new = make_avatar(atlas, DECODED).state_dict()
    for name, parameter in avatar.named_parameters():
        assert torch.isfinite(parameter).all() and torch.isfinite(parameter.grad).all(), name
        if name.startswith("networks."):
            assert not torch.equal(parameter, new[name]), name
    poses = [avatar.prepare(FrameInputs(atlas, frame)) for frame in frames]
    assert not torch.equal(poses[0].parameters.transfer_color, poses[1].parameters.transfer_color)


def test_decoder_follows_a_pose_between_those_it_learned():
    """A corner lifted by f: the opacity's logit shall rise by 10 f. Learned at five lifts, asked at others."""
    atlas = make_sheet(8)
    spec = AvatarSpec(True, False, 4, 1, 0.1, parameters="decoded", articulation=True, **SMALL)
    torch.manual_seed(0)
    code = PoseCode(atlas, spec)
    decoder = PoseDecoder(atlas, code.size, spec.decoder_channels, {"opacity": torch.zeros(atlas.texel_count)}, {})
    optimizer = torch.optim.Adam([*code.parameters(), *decoder.parameters()], lr=1e-2)
    for _ in range(200):
        optimizer.zero_grad()
        loss = sum(
            (decoder(code(folded(atlas, f).vertices))["opacity"] - 10 * f).square().mean()
            for f in (0.0, 0.05, 0.1, 0.15, 0.2)
        )
        loss.backward()
        optimizer.step()
    for unseen in (0.03, 0.12, 0.18):
        found = decoder(code(folded(atlas, unseen).vertices))["opacity"]
        assert (found - 10 * unseen).abs().max() < 0.2  # a tenth of what the largest lift makes


def test_networks_know_no_place_in_the_world():
    """Subject, camera and lamps moved together: what each texel is and shows stays."""
    atlas = make_sheet(8)
    frame = folded(atlas, 0.05)
    avatar = trained(atlas, [frame, folded(atlas, 0.1, 1)])
    turn, shift = Rotation.from_euler("xyz", [0.4, 1.1, -0.6]), np.array([0.3, -0.2, 0.5])
    moved = dataclasses.replace(
        frame,
        vertices=(turn.apply(frame.vertices) + shift).astype(np.float32),
        light_positions=(turn.apply(frame.light_positions) + shift).astype(np.float32),
    )
    center = np.array([0.1, 0.2, 1.0])
    here, there = (avatar.prepare(FrameInputs(atlas, record)) for record in (frame, moved))
    seen = [
        avatar.built.specular.visibility(avatar.viewed(prepared, torch.tensor(place, dtype=torch.float32)))
        for prepared, place in ((here, center), (there, turn.apply(center) + shift))
    ]
    assert (seen[0] - seen[1]).abs().max() < FLOAT32_ROUNDING
    for name in ("log_scale", "transfer_color", "offset"):
        difference = getattr(here.parameters, name) - getattr(there.parameters, name)
        assert difference.abs().max() < FLOAT32_ROUNDING, name
    assert (here.shading.diffuse - there.shading.diffuse).abs().max() < FLOAT32_ROUNDING
    elsewhere = avatar.built.specular.visibility(avatar.viewed(here, torch.tensor([-1.0, 0.0, 0.3])))
    assert (seen[0] - elsewhere).abs().max() > 0  # and yet it depends on the view


def test_avatar_with_networks_comes_back_from_its_files(tmp_path):
    atlas = make_sheet(8)
    frame = folded(atlas, 0.05)
    avatar = trained(atlas, [frame])
    write_atlas(tmp_path / "atlas.safetensors", atlas)
    save_avatar(tmp_path / "avatar", avatar, {})
    image = make_image(frame, ALBEDO, 0.1)
    loaded = load_avatar(tmp_path / "avatar", tmp_path / "atlas.safetensors")
    assert loaded.avatar.spec == avatar.spec
    for found, expected in zip(
        loaded.render(frame, image), LoadedAvatar(avatar, atlas).render(frame, image), strict=True
    ):
        assert torch.equal(found, expected)


def test_pose_offsets_forget_rigid_motion_and_keep_what_bends():
    generator = np.random.default_rng(0)
    rest = generator.normal(size=(20, 3))
    turn, shift = Rotation.random(rng=1), np.array([5.0, -2.0, 1.0])
    assert np.abs(pose_offsets(rest, turn.apply(rest) + shift)).max() < 1e-12
    bent = rest + 0.1 * generator.normal(size=rest.shape)
    here, there = pose_offsets(rest, bent), pose_offsets(rest, turn.apply(bent) + shift)
    np.testing.assert_allclose(here, there, atol=1e-12)
    assert np.abs(here).max() > 0.05
    np.testing.assert_allclose(pose_offsets(0.01 * rest, 0.01 * bent), here, atol=1e-12)  # of any size
    assert np.isfinite(pose_offsets(np.zeros((4, 3)), np.zeros((4, 3)))).all()


def test_faces_that_are_none_are_told():
    atlas = make_sheet(8)
    assert set(face_points(atlas, (0.0, 0.0, 0.0, 1.0), 9)) == set(body_points(atlas, 9)) == {0, 1, 2, 3}
    with pytest.raises(InputError, match="x y z and a radius"):
        face_points(atlas, (0.0, 1.0, 2.0), 9)
    with pytest.raises(InputError, match=r"at least 4 vertices.*found 1; the template at rest reaches from"):
        face_points(atlas, (0.2, 0.2, 0.0, 0.1), 9)


@pytest.mark.parametrize(("size", "side"), [(48, 16), (16, 16), (16, 64)])
def test_bilinear_is_torchs(size, side):
    atlas = make_sheet(size)
    coarse = torch.rand(2, side, side, generator=torch.Generator().manual_seed(0))
    nearest, weights = bilinear(atlas, side)
    found = (coarse.flatten(1)[:, torch.as_tensor(nearest)] * torch.as_tensor(weights)).sum(-1)
    full = torch.nn.functional.interpolate(coarse[None], (size, size), mode="bilinear", align_corners=False)[0]
    assert torch.allclose(atlas.from_map(full), found, atol=FLOAT32_ROUNDING)


def test_decoder_has_the_papers_layers():
    """RGCA's channels make 1024 x 1024 from 8 x 8; here the same with one channel each, as far as 64 x 64."""
    decoder = AtlasDecoder(make_sheet(16), 3, (2, 3, 4), 5, starts_at_zero=True)
    biases = [layer.bias if layer.bias is None else tuple(layer.bias.shape) for layer in decoder.layers]
    assert biases == [(3, 16, 16), (4, 32, 32), None]
    features = torch.ones(1, 2, 8, 8)
    for layer, side in zip(decoder.layers, (16, 32, 64), strict=True):
        features = layer(features)
        assert features.shape[-1] == side
        weight = layer.conv.weight
        norms = layer.conv.parametrizations.weight.original0.flatten()
        assert torch.allclose(weight.square().sum((0, 2, 3)).sqrt(), norms, atol=1e-6)  # per output channel
    assert decoder(torch.ones(3)).shape == (256, 5) and (decoder(torch.ones(3)) == 0).all()


@pytest.mark.parametrize(("plain", "learns"), [(False, False), (True, True)])
def test_plain_last_layer_starts_at_zero_and_knows_at_once_which_way_to_go(plain, learns):
    """Of length zero, weight-normalised weights have a slope of their length alone."""
    torch.manual_seed(0)
    decoder = AtlasDecoder(make_sheet(16), 3, (2, 3), 5, starts_at_zero=True, plain=plain)
    found = decoder(torch.ones(3))
    assert (found == 0).all()
    (found * torch.randn(5)).sum().backward()
    last = decoder.layers[-1].conv
    weights = last.weight if plain else last.parametrizations.weight.original1
    assert bool(weights.grad.abs().max() > 0) == learns


def test_a_labelled_face_has_a_code_of_its_own_and_else_the_head():
    def sizes(**regions):
        atlas = dataclasses.replace(make_sheet(8), regions={name: np.array(v) for name, v in regions.items()})
        spec = resolve_spec(DECODED, PLANNED)
        return {name: len(part.chosen) for name, part in PoseCode(atlas, spec).parts.items()}

    assert sizes() == {"body": 4}
    assert sizes(face=[0, 1, 2, 3]) == sizes(head=[0, 1, 2, 3]) == {"body": 4, "face": 4}
    assert sizes(face=[0, 1, 2], head=[0, 1, 2, 3]) == {"body": 4}  # too few to tell a motion, and no other meant
    off = resolve_spec(DECODED.model_copy(update={"face_code": "off"}), PLANNED)
    atlas = dataclasses.replace(make_sheet(8), regions={"face": np.arange(4)})
    assert list(PoseCode(atlas, off).parts) == ["body"]
