"""An avatar under new light: linear in it where it should be, the same by pixels and by lobes, the same from a .ply."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from pipeline.avatar.model import Avatar
from pipeline.avatar.relighting.driving_signal import DrivingSignal
from pipeline.avatar.relighting.film import Relighter, view_independent_color
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.avatar.training.checkpoint import LoadedAvatar
from pipeline.config.trace_irradiance import TraceIrradiance
from pipeline.geometry.camera_paths import look_at
from pipeline.lighting.environment import Environment
from pipeline.lighting.frame_lights import FrameLights
from pipeline.rendering.splat_ply import Splats, read_splats, write_splats
from pipeline.rendering.splat_types import CameraView, Gaussians, SplatOptions, Supersampling
from pipeline.rendering.supersample import splat_supersampled
from tests.support.avatars import eyeballs
from tests.support.avatars.sheet import make_sheet

SHEET = make_sheet(12)
CAMERA = look_at(np.array([0.1, 0.05, 0.9]), np.zeros(3), 30.0, 40, 30)
KEY = FrameLights(np.array([[0.4, 0.5, 1.5], [-0.3, 0.1, 0.8]]), np.array([[3.0, 2, 1], [0.5, 1, 2]]))
FILL = FrameLights(np.array([[-0.6, -0.2, 1.1]]), np.array([[1.0, 1.5, 0.3]]))
TURN = Rotation.from_euler("y", 40, degrees=True).as_matrix()


def relighter(specular: bool = True, shadow: bool = False, **other) -> Relighter:
    """An avatar whose parameters are all away from where they start."""
    torch.manual_seed(0)
    spec = AvatarSpec(specular=specular, shadow=shadow, shadow_width=4, supersample=2, dilation_px2=0.1, **other)
    avatar = Avatar(SHEET, texel_spacing(SHEET), spec)
    spread = {"albedo": 0.1, "transfer_color": 0.03, "transfer_mono": 0.03, "normal_offset": 0.1, "rotation": 0.2}
    with torch.no_grad():
        for name, parameter in avatar.named_parameters():
            parameter += spread.get(name, 0.05 if "shadow_net" in name else 0) * torch.randn_like(parameter)
        if spec.lobe:
            avatar.visibility += 2
    return Relighter(LoadedAvatar(avatar, SHEET), TraceIrradiance())


def test_networks_follow_a_new_pose_under_a_new_light() -> None:
    """A folded sheet: its own shape and light, by lamps and by lobes, from the same networks."""
    it = relighter(parameters="decoded", articulation=True, pose_points=4, code_size=8, decoder_channels=(8, 4))
    torch.manual_seed(1)
    with torch.no_grad():  # as if they had learned something
        for name, parameter in it.avatar.named_parameters():
            if name.startswith(("networks.pose.", "networks.view.")):
                parameter += 0.1 * torch.randn_like(parameter)
    folded = SHEET.rest_vertices + np.array([[0, 0, 0], [0, 0, 0.1], [0, 0, 0], [0, 0, 0]], np.float32)
    flat = it.under_lights(SHEET.rest_vertices, KEY)
    lamps, lobes = it.under_lights(folded, KEY), it.under_sky(folded, it.prepare_sky(sky()), sky(), TURN)
    for name in ("offset", "log_scale", "opacity", "transfer_color"):
        own = [getattr(frame.parameters, name) for frame in (lamps, lobes, flat)]
        assert torch.equal(own[0], own[1])
        assert not torch.equal(own[0], own[2])
    center = torch.tensor([0.1, 0.05, 0.9])
    assert torch.equal(
        *(it.avatar.built.specular.visibility(it.avatar.viewed(frame, center)) for frame in (lamps, lobes))
    )
    for frame in (lamps, lobes):
        assert it.view(frame, CAMERA)[0].isfinite().all()


def together(*lights: FrameLights) -> FrameLights:
    return FrameLights(
        np.concatenate([one.positions for one in lights]), np.concatenate([one.intensities for one in lights])
    )


def render(it: Relighter, lights: FrameLights) -> torch.Tensor:
    return it.view(it.under_lights(SHEET.rest_vertices, lights), CAMERA)[0]


def sky(height: int = 16, seed: int = 0) -> Environment:
    return Environment((np.random.default_rng(seed).random((height, 2 * height, 3)) ** 4).astype(np.float32))


def stars(height: int = 32) -> Environment:
    """A map of fifty bright pixels; the others are black and cost nothing."""
    generator, radiance = np.random.default_rng(0), np.zeros((2 * height * height, 3), np.float32)
    radiance[generator.choice(len(radiance), 50, replace=False)] = 20 * generator.random((50, 3))
    return Environment(radiance.reshape(height, 2 * height, 3))


def render_sky(it: Relighter, light: Environment, by: str, turn: np.ndarray = TURN) -> torch.Tensor:
    if by == "pixels":
        frame = it.under_pixels(SHEET.rest_vertices, light, turn)
    else:
        frame = it.under_sky(SHEET.rest_vertices, it.prepare_sky(light), light, turn)
    return it.view(frame, CAMERA)[0]


@pytest.mark.parametrize("shadow", [False, True])
def test_scaled_light_scales_the_picture_to_the_last_bit(shadow) -> None:
    """With the shadow network, too: it sees the light normalised."""
    it = relighter(shadow=shadow)
    four = FrameLights(KEY.positions, 4 * KEY.intensities)
    torch.testing.assert_close(render(it, four), 4 * render(it, KEY), rtol=0, atol=0)
    bright = Environment(4 * sky().radiance)
    torch.testing.assert_close(
        render_sky(it, bright, "lobes"), 4 * render_sky(it, sky(), "lobes"), rtol=1e-5, atol=1e-6
    )


@pytest.mark.parametrize(
    "variant",
    [
        {},
        {"shading": "harmonics"},
        {"deferred": False},
        {"indirect": "ambient"},
        {"shadow": True, "visibility": "traced", "indirect": "bounce"},
        {"shading": "microfacet", "shadow": True, "visibility": "traced"},
    ],
)
def test_lights_superpose_without_a_shadow_network(variant) -> None:
    it = relighter(**variant)
    one, other, both = (render(it, lights) for lights in (KEY, FILL, together(KEY, FILL)))
    assert float(one.max()) > 0.1
    torch.testing.assert_close(both, one + other, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("by", ["pixels", "lobes"])
def test_environments_superpose_without_a_shadow_network(by) -> None:
    it, one, other = relighter(), sky(seed=1), sky(seed=2)
    both = Environment(one.radiance + other.radiance)
    pictures = [render_sky(it, light, by) for light in (one, other, both)]
    torch.testing.assert_close(pictures[2], pictures[0] + pictures[1], rtol=1e-5, atol=1e-6)


def test_shadow_network_is_the_only_part_that_is_not_linear() -> None:
    """Diffuse light superposes in every frame; its factor from the network does not."""
    it = relighter(shadow=True)
    one, other, both = (it.under_lights(SHEET.rest_vertices, lights) for lights in (KEY, FILL, together(KEY, FILL)))
    torch.testing.assert_close(both.shading.diffuse, one.shading.diffuse + other.shading.diffuse, rtol=1e-5, atol=1e-6)
    plain = relighter().under_lights(SHEET.rest_vertices, KEY)
    assert {name for name, layer in vars(one.shading).items() if layer is not None} == {"diffuse", "shadow"}
    assert {name for name, layer in vars(plain.shading).items() if layer is not None} == {"diffuse"}


def test_light_that_is_off_changes_nothing() -> None:
    dark = FrameLights(FILL.positions, 0 * FILL.intensities)
    for shadow in (False, True):
        it = relighter(shadow=shadow)
        torch.testing.assert_close(render(it, together(KEY, dark)), render(it, KEY), rtol=0, atol=0)
        assert float(render(it, dark).abs().max()) == 0


@pytest.mark.parametrize("by", ["pixels", "lobes"])
def test_no_light_at_all_is_black(by) -> None:
    black = Environment(np.zeros((8, 16, 3), np.float32))
    assert float(render_sky(relighter(shadow=True), black, by).abs().max()) == 0


@pytest.mark.parametrize(
    ("shadow", "other"),
    [(False, {}), (True, {}), (False, {"deferred": False}), (False, {"shading": "harmonics", "fresnel": "none"})],
)
def test_lobes_show_what_all_pixels_show(shadow, other) -> None:
    """Roughness is above the map's pixel, so the sum over its pixels is what look-ups stand for."""
    it = relighter(shadow=shadow, **other)
    with torch.no_grad():
        it.avatar.log_roughness.fill_(np.log(0.2)).add_(0.2 * torch.rand(144))
    light = stars() if other else sky(32)
    pixels, lobes = (render_sky(it, light, by) for by in ("pixels", "lobes"))
    assert float((pixels - lobes).abs().max() / pixels.max()) < 0.01
    matte = relighter(
        specular=False, shadow=shadow, **other
    )  # without the look-up's error: harmonics against Legendre sums
    pixels, lobes = (render_sky(matte, light, by) for by in ("pixels", "lobes"))
    torch.testing.assert_close(lobes, pixels, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("lids", ["traced", "learned"])
def test_lobes_show_what_all_pixels_show_of_a_head_with_eyes(lids) -> None:
    """One look-up per Gaussian, and one per pixel of an eye (RGCA section 3.3)."""
    atlas = eyeballs.eye_atlas()
    decoded = {"eye_parameters": "decoded", "lids": lids} if lids == "learned" else {}
    avatar = eyeballs.make_avatar(
        atlas, eyeballs.EYES, avatar="head", shading="harmonics", deferred=False, fresnel="none", anchors="tracked",
        pose_points=4, code_size=4, decoder_channels=(8, 4), **decoded,
    )  # fmt: skip
    with torch.no_grad():
        avatar.log_roughness.fill_(np.log(0.2)).add_(0.2 * torch.rand(atlas.texel_count))
        avatar.albedo.copy_(torch.rand(atlas.texel_count, 3))
    it = Relighter(LoadedAvatar(avatar, atlas), TraceIrradiance())
    record = eyeballs.make_frame(atlas, eyeballs.gaze(15, -10), eyeballs.LIGHTS, eyeballs.moved_head())
    signal = DrivingSignal(record.vertices, record.head_from_world, gaze=record.gaze)
    # So near that a pixel adds little to the width of the lobe of an eye.
    camera = look_at(eyeballs.CAMERA, eyeballs.CENTERS["eye_l"], 3.0, 40, 30)
    light = stars()
    assert it.prefilters
    frames = [it.under_pixels(signal, light, TURN), it.under_sky(signal, it.prepare_sky(light), light, TURN)]
    pixels, lobes = (it.view(frame, camera)[0] for frame in frames)
    assert float((pixels - lobes).abs().max() / pixels.max()) < 0.01 and float(pixels.max()) > 0.1
    torch.testing.assert_close(frames[0].shading.diffuse, frames[1].shading.diffuse, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("by", ["pixels", "lobes"])
def test_turned_map_lights_as_one_whose_columns_are_shifted(by) -> None:
    """A quarter turn is eight columns of 32: +z comes to lie along +x, and a map's columns move left (or wrap)."""
    quarter = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    light = sky()
    directions = light.directions()
    np.testing.assert_allclose(directions @ quarter.T, np.roll(directions, 8, 1), atol=1e-12)
    it = relighter()
    shifted = Environment(np.roll(light.radiance, -8, 1))
    turned, expected = render_sky(it, light, by, quarter), render_sky(it, shifted, by, np.eye(3))
    torch.testing.assert_close(turned, expected, rtol=1e-3, atol=1e-4)


def test_only_learned_transfer_without_traced_light_goes_by_lobes() -> None:
    assert relighter(shadow=True).prefilters
    assert not relighter(shadow=True, visibility="traced").prefilters
    assert not relighter(indirect="ambient").prefilters
    assert not relighter(highlight="half").prefilters
    assert not relighter(shading="microfacet").prefilters
    assert relighter(deferred=False).prefilters and relighter(shading="harmonics").prefilters


def splat(splats: Splats, spec: AvatarSpec) -> torch.Tensor:
    R, t, K = (torch.tensor(array, dtype=torch.float32) for array in (CAMERA.R, CAMERA.t, CAMERA.K))
    facing = (splats.normals * (torch.tensor(CAMERA.center).float() - splats.means)).sum(1) > 0
    gaussians = Gaussians(splats.means, splats.quaternions, splats.scales, splats.opacities * facing)
    view, options = CameraView(R, t, K, CAMERA.width, CAMERA.height), SplatOptions(spec.dilation_px2)
    return splat_supersampled(gaussians, splats.rgb_linear, view, options, Supersampling(spec.supersample)).features


@pytest.mark.parametrize("shadow", [False, True])
def test_splats_from_a_file_look_like_the_view_independent_part(tmp_path, shadow) -> None:
    it = relighter(specular=False, shadow=shadow)
    frame = it.under_lights(SHEET.rest_vertices, together(KEY, FILL))
    color = view_independent_color(frame)
    assert float(color.min()) > 0
    assert float(color.max()) < 1  # nothing is clipped
    shapes = (frame.gaussians.opacities, frame.gaussians.scales, frame.gaussians.quaternions)
    made = Splats(frame.gaussians.means, frame.surface.posed.normals, color, *shapes)
    write_splats(tmp_path / "a.ply", made)
    found = splat(read_splats(tmp_path / "a.ply"), it.avatar.spec)
    torch.testing.assert_close(found, splat(made, it.avatar.spec), rtol=1e-4, atol=1e-5)
    if not shadow:  # the avatar itself blends shadow apart from colour
        torch.testing.assert_close(found, it.view(frame, CAMERA)[0], rtol=1e-4, atol=1e-5)
    brighter = replace(made, rgb_linear=1.05 * made.rgb_linear)
    assert float((splat(brighter, it.avatar.spec) - found).abs().max()) > 1e-3  # what a real difference looks like
