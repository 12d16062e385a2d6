"""Training on a sheet whose picture is known in closed form: it learns the albedo, and continues bit for bit."""

import dataclasses

import numpy as np
import pytest
import torch

from pipeline.avatar.appearance.models import ShadowModel
from pipeline.avatar.appearance.penalties import outside
from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.model import Avatar
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.spec.planned import resolve_spec
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.avatar.training.checkpoint import LoadedAvatar, camera_view
from pipeline.avatar.training.losses import photometric, silhouette
from pipeline.avatar.training.optimizer import rate_share
from pipeline.avatar.training.training import BrokenStep, Position, Training
from pipeline.avatar.training.training_images import Schedule
from pipeline.base.files import read_arrays
from pipeline.config.train_avatar import TrainAvatar
from tests.support.avatars.sheet import make_frame, make_image, make_sheet
from tests.support.avatars.variants import PAPER, VARIANTS

ALBEDO = np.array([0.7, 0.4, 0.2])
PLANNED = {"shadow", "near_field", "articulation", "specular", "deferred", "learned_transport"}
SPEC = AvatarSpec(specular=True, shadow=True, shadow_width=4, supersample=2, dilation_px2=0.1)


def one_light(position, number=0):
    return make_frame(make_sheet(16), np.array([position]), np.array([[3.0, 3.0, 3.0]]), number)


@pytest.fixture
def scene():
    atlas = make_sheet(16)
    places = [[0.5, 0.3, 1.5], [-0.6, 0.0, 1.2], [0.1, -0.5, 1.4], [-0.3, 0.5, 1.3], [0.6, -0.3, 1.2]]
    frames = [one_light(place, number) for number, place in enumerate(places)]
    images = [make_image(frame, ALBEDO, shift) for frame in frames for shift in (-0.2, 0.2)]
    return atlas, {frame.frame: FrameInputs(atlas, frame) for frame in frames}, images


def train(scene, settings, steps, start=None, folder=None, spec=SPEC):
    atlas, frames, images = scene
    torch.manual_seed(0)
    avatar = Avatar(atlas, texel_spacing(atlas), spec)
    training = Training(avatar, settings, images=len(images))
    schedule = Schedule("sheet", [image.frame for image in images], settings.cameras_per_step)
    at = training.restore(start, "same") if start else Position()
    for step in range(at.step, steps):
        batch = [images[i] for i in schedule[step]]
        training.take_step(step, frames[batch[0].frame], batch)
    if folder:
        training.save(folder, Position(steps), "same")
    return avatar


def test_rates_fall_exponentially_and_in_a_straight_line_to_nothing_at_last():
    settings = TrainAvatar(steps=100, final_rate=0.04, cooldown=0.2)
    shares = [rate_share(step, settings) for step in range(100)]
    assert shares[0] == 1 and shares[50] == pytest.approx(0.2)
    # At the last step a twentieth of the straight line is left, of 20 steps.
    assert shares[80] == pytest.approx(0.04**0.8) and shares[99] == pytest.approx(0.04**0.99 / 20)
    assert rate_share(99, settings.model_copy(update={"cooldown": 0.0})) == pytest.approx(0.04**0.99)
    assert (np.diff(shares) < 0).all() and min(shares) > 0


def test_learns_a_lambertian_sheet_and_relights_it(scene):
    """Under a light from a new direction, seen from a new camera, within the truncation of the transfer (2 %)."""
    settings = TrainAvatar(steps=150, cameras_per_step=2)
    avatar = train(scene, settings, settings.steps)
    frame = one_light([0.3, -0.1, 1.3], 9)
    image = make_image(frame, ALBEDO, shift_x=0.05)
    rgb, alpha = LoadedAvatar(avatar, scene[0]).render(frame, image)
    assert np.median(relative_errors(rgb, image)) < 0.03
    assert alpha.numpy()[8:16, 8:16].min() > 0.9


@pytest.mark.parametrize("name", VARIANTS)
def test_every_variant_learns_the_sheet_under_its_lights(scene, name):
    """The relative error of the sheet's middle after a few steps; a flat sheet asks little of any of them."""
    atlas, frames, _ = scene
    settings = TrainAvatar(steps=50, cameras_per_step=2, **VARIANTS[name])
    avatar = train(scene, settings, settings.steps, spec=resolve_spec(settings, PLANNED))
    image = make_image(frames[0].record, ALBEDO, shift_x=0.05)
    rgb, _ = LoadedAvatar(avatar, atlas).render(frames[0].record, image)
    assert np.median(relative_errors(rgb, image)) < 0.1


def relative_errors(rgb, image):
    """Of the pixels of the sheet whose neighbours are on it as well."""
    inside = image.mask.astype(bool)
    inside[1:-1, 1:-1] &= inside[:-2, 1:-1] & inside[2:, 1:-1] & inside[1:-1, :-2] & inside[1:-1, 2:]
    return np.abs(rgb.numpy() - image.image)[inside] / image.image[inside]


def test_only_what_a_variant_needs_is_built(scene):
    atlas = scene[0]

    def names(**choices):
        spec = resolve_spec(TrainAvatar(**PAPER | choices), PLANNED)
        return {name.split(".")[0] for name, _ in Avatar(atlas, texel_spacing(atlas), spec).named_parameters()}

    full = names()
    assert full - names(**VARIANTS["pbr"]) == {
        "transfer_color", "transfer_mono", "log_roughness", "visibility", "shadow_net"
    }  # fmt: skip
    assert full - names(shadow=False) == {"shadow_net"}
    assert full - names(normals="mesh") == {"normal_offset"}
    assert names(indirect="ambient") - full == {"ambient"}
    assert names(shading="combined") - names(**VARIANTS["pbr"]) == {"transfer_color", "transfer_mono"}
    assert names(shading="subsurface") - names(**VARIANTS["pbr"]) == {"subsurface"}


def test_traced_shadows_and_gloss_are_linear_in_the_light(scene):
    """Superposition holds for shadows as well once every light has its own."""
    atlas, _, images = scene
    settings = TrainAvatar(steps=20, **VARIANTS["pbr"])
    avatar = train(scene, settings, 20, spec=resolve_spec(settings, PLANNED))
    positions, power = np.array([[0.5, 0.3, 1.5], [-0.4, 0.2, 1.0]]), np.array([[3.0, 2.0, 1.0], [1.0, 2.0, 4.0]])
    pictures = [
        LoadedAvatar(avatar, atlas).render(make_frame(atlas, positions[chosen], power[chosen]), images[0])[0]
        for chosen in ([0], [1], [0, 1])
    ]
    assert torch.allclose(pictures[0] + pictures[1], pictures[2], rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("name", VARIANTS)
def test_lights_that_are_blended_together_look_as_each_by_itself(scene, name):
    """To the bit: channels are blended side by side, and know nothing of each other."""
    atlas, _, images = scene
    positions = np.array([[0.5, 0.3, 1.5], [-0.4, 0.2, 1.0], [0.1, 0.6, 1.2]])
    power = np.array([[3.0, 2.0, 1.0], [1.0, 2.0, 4.0], [2.0, 2.0, 2.0]])
    frame = FrameInputs(atlas, make_frame(atlas, positions, power))
    avatar = Avatar(atlas, texel_spacing(atlas), resolve_spec(TrainAvatar(**VARIANTS[name]), PLANNED))
    camera = camera_view(images[0])
    with torch.no_grad():
        prepared = [avatar.prepare(frame.with_light(number)) for number in range(3)]
        together, each = avatar.views(prepared, camera), [avatar.view(one, camera) for one in prepared]
    assert all(torch.equal(a.rgb, b.rgb) and torch.equal(a.alpha, b.alpha) for a, b in zip(together, each, strict=True))
    assert not torch.allclose(together[0].rgb, together[1].rgb, rtol=0.1)


def test_far_lamps_may_be_taken_as_distant(scene):
    """At 60 m, over a sheet of 0.4 m, light changes by 1 %, which is what `near_field: off` leaves out."""
    atlas, _, images = scene
    frame = make_frame(atlas, np.array([[20.0, 10.0, 55.0], [-10.0, 5.0, 58.0]]), np.full((2, 3), 5e3))
    pictures = []
    for planned in ({"near_field", "articulation"}, {"articulation"}):
        avatar = Avatar(atlas, texel_spacing(atlas), resolve_spec(TrainAvatar(specular="off"), planned))
        pictures.append(LoadedAvatar(avatar, atlas).render(frame, images[0])[0])
    assert not torch.equal(*pictures)
    assert torch.allclose(*pictures, rtol=0.02, atol=1e-3)


def test_continued_training_is_bitwise_the_same(scene, tmp_path):
    settings = TrainAvatar(steps=12, cameras_per_step=2)
    whole = train(scene, settings, 12)
    train(scene, settings, 5, folder=tmp_path / "state.safetensors")
    continued = train(scene, settings, 12, start=tmp_path / "state.safetensors")
    for name, tensor in whole.state_dict().items():
        assert torch.equal(tensor, continued.state_dict()[name]), name


def test_a_state_of_another_training_is_not_used(scene, tmp_path):
    settings = TrainAvatar(steps=2)
    train(scene, settings, 1, folder=tmp_path / "state.safetensors")
    avatar = Avatar(scene[0], texel_spacing(scene[0]), SPEC)
    before = avatar.albedo.clone()
    assert Training(avatar, settings).restore(tmp_path / "state.safetensors", "other") == Position()
    assert torch.equal(before, avatar.albedo)


def test_rendering_is_linear_in_the_light(scene):
    """Superposition: the picture under two lights is the sum of the pictures under each."""
    atlas, _, images = scene
    avatar = train(scene, TrainAvatar(steps=20), 20)
    # Normalised irradiance is a ratio: not linear, by design.
    avatar = avatar.variant(shadow=ShadowModel(avatar, SPEC))
    positions, power = np.array([[0.5, 0.3, 1.5], [-0.4, 0.2, 1.0]]), np.array([[3.0, 2.0, 1.0], [1.0, 2.0, 4.0]])
    pictures = [
        LoadedAvatar(avatar, atlas).render(make_frame(atlas, positions[chosen], power[chosen]), images[0])[0]
        for chosen in ([0], [1], [0, 1])
    ]
    assert torch.allclose(pictures[0] + pictures[1], pictures[2], rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("planted", [np.nan, np.inf])
def test_a_loss_that_is_not_finite_stops_the_step_and_changes_nothing(scene, tmp_path, planted):
    _, frames, images = scene
    training = training_of(scene)
    training.take_step(0, frames[0], images[:2])
    training.save(tmp_path / "before.safetensors", Position(1), "same")
    image = images[0].image.copy()
    image[12, 12, 1] = planted
    with pytest.raises(BrokenStep, match=r"terms: photometric \((nan|inf)\)"):
        training.take_step(1, frames[0], [dataclasses.replace(images[0], image=image), images[1]])
    training.save(tmp_path / "after.safetensors", Position(1), "same")
    after, before = (read_arrays(tmp_path / f"{name}.safetensors") for name in ("after", "before"))
    for key in before:
        np.testing.assert_array_equal(after[key], before[key], err_msg=key)


@pytest.mark.parametrize("planted", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", ["offset", "albedo", "shadow_net.last.bias"])
def test_a_gradient_that_is_not_finite_is_named_and_no_other(scene, name, planted):
    _, frames, images = scene
    training = training_of(scene)
    training.avatar.get_parameter(name).register_hook(
        lambda gradient: gradient.index_fill(0, torch.tensor([0]), planted)
    )
    with pytest.raises(BrokenStep, match=rf"others in gradients of: {name}$"):
        training.take_step(0, frames[0], images[:2])


def test_gradients_whose_sum_overflows_are_finite(scene):
    training = training_of(scene)
    training.gradients.flat.fill_(1e38)
    assert not torch.isfinite(training.gradients.flat.sum())
    assert training.gradients.not_finite() == []


def test_gaussians_that_are_not_finite_stop_the_step(scene):
    """The splatting refuses them; what it says is told."""
    _, frames, images = scene
    training = training_of(scene)
    with torch.no_grad():
        training.avatar.log_scale[3] = 200.0
    with pytest.raises(BrokenStep, match="in Gaussians: scales: expected finite numbers"):
        training.take_step(0, frames[0], images[:2])


def training_of(scene, **choices):
    settings = TrainAvatar(steps=4, **choices)
    torch.manual_seed(0)
    return Training(Avatar(scene[0], texel_spacing(scene[0]), SPEC), settings)


def test_schedule_shows_every_image_once_an_epoch_and_one_frame_a_step(scene):
    _, _, images = scene
    frames = [image.frame for image in images]
    schedule = Schedule("sheet", frames, 2)
    for epoch in range(2):
        steps = [schedule[epoch * schedule.steps_per_epoch + i] for i in range(schedule.steps_per_epoch)]
        assert sorted(i for step in steps for i in step) == list(range(len(images)))
        assert all(len({images[i].frame for i in step}) == 1 for step in steps)
    assert schedule[0] == Schedule("sheet", frames, 2)[0]


def test_each_place_of_a_round_has_frames_of_its_own():
    """An odd number of steps in an epoch, so that its first step is at another place in each."""
    frames = [frame for frame in range(7) for _ in range(5)]
    schedule = Schedule("sheet", frames, 2, steps_together=2)
    assert schedule.steps_per_epoch == 21
    seen: list[list[int]] = [[], []]
    for epoch in range(4):
        steps = range(epoch * 21, (epoch + 1) * 21)
        assert sorted(i for step in steps for i in schedule[step]) == list(range(len(frames)))
        for step in steps:
            seen[step % 2].append(frames[schedule[step][0]])
    # 4 and 3 frames, 12 and 9 steps. Epochs begin at one place, with 11 and 10 steps, or at the other: 1 or 2 are lent.
    assert sum(min(seen[0].count(frame), seen[1].count(frame)) for frame in range(7)) == 2 * (1 + 2)
    orders = [[frames[schedule[epoch * 21 + i][0]] for i in range(21)] for epoch in range(2)]
    assert orders[0] != orders[1], "random order"


def test_bound_is_zero_inside_and_its_slope_finite_everywhere():
    value = torch.tensor([1e-30, 1e-7, 5e-5, 1e-3, 0.5, 1e6], requires_grad=True)
    for i in range(len(value)):
        (slope,) = torch.autograd.grad(outside(value[i], 1e-4, 1e-2), value)
        assert torch.isfinite(slope).all()
        assert (slope[i] == 0) == (i == 3)


def test_photometric_loss_does_not_depend_on_the_margin():
    generator = torch.Generator().manual_seed(0)
    rgb, captured = torch.rand(2, 6, 6, 3, generator=generator)
    mask = torch.ones(6, 6)
    pad = (0, 0, 3, 3, 3, 3)
    wide = [torch.nn.functional.pad(tensor, pad) for tensor in (rgb, captured)]
    found = photometric(*wide, torch.nn.functional.pad(mask, pad[2:]), "ignored").item()
    assert found == pytest.approx(photometric(rgb, captured, mask, "ignored").item(), rel=1e-6)


def test_photometric_loss_knows_what_edges_are():
    """One pixel of mask in the middle: its neighbours count as captured or not at all, those further out are black."""
    mask = torch.zeros(5, 5)
    mask[2, 2] = 1
    captured = torch.ones(5, 5, 3)
    near = torch.zeros(5, 5, 3)
    near[1:4, 1:4] = 1
    assert photometric(near, captured, mask, "captured").item() == 0
    assert photometric(near, captured, mask, "ignored").item() == 0
    assert photometric(captured, captured, mask, "captured").item() == pytest.approx(16)
    assert photometric(torch.zeros(5, 5, 3), captured, mask, "captured").item() == pytest.approx(9)
    assert photometric(torch.zeros(5, 5, 3), captured, mask, "ignored").item() == pytest.approx(1)


def test_silhouette_ignores_the_edge_of_the_mask():
    mask = torch.zeros(8, 8)
    mask[2:6, 2:6] = 1
    alpha = mask.clone()
    alpha[1, 1:7] = 0.5  # touches the edge
    assert silhouette(alpha, mask).item() == 0
    alpha[3, 3] = 0.5
    assert silhouette(alpha, mask).item() == pytest.approx(0.5 / 16)
