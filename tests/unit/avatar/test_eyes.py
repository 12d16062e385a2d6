"""Explicit eyes: on their spheres, glints where the mirror law says, lids, colours by direction, and refinement."""

import math
from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from pipeline.avatar.checkpoint import LoadedAvatar, load_avatar, save_avatar
from pipeline.avatar.driving import from_record
from pipeline.avatar.eye_glints import trace_spheres
from pipeline.avatar.eyes import MOST_GROWTH, MOST_SHIFT_M, START_VISIBILITY, Eyes
from pipeline.avatar.losses import regularization
from pipeline.avatar.pose import FrameInputs
from pipeline.avatar.relighting import Relighter
from pipeline.avatar.training import Training
from pipeline.base.errors import InputError
from pipeline.config.trace_irradiance import TraceIrradiance
from pipeline.config.train_avatar import TrainAvatar
from pipeline.geometry.cameras import Camera
from pipeline.geometry.eye_shape import EyeShape, usual_shape
from pipeline.geometry.texels import write_atlas
from pipeline.lighting.environment import Environment
from pipeline.lighting.frame_lights import FrameLights
from pipeline.lighting.lobes import LOBE_CONSTANT
from pipeline.synthesis.eyeball import CORNEA_OFFSET_M, CORNEA_RADIUS_M, EYE_RADIUS_M
from pipeline.synthesis.mitsuba_scenes import mitsuba
from tests.unit.avatar.eyeballs import (
    AHEAD,
    CENTERS,
    centroid,
    glint_points,
    make_atlas,
    make_avatar,
    make_eyes,
    make_frame,
    make_image,
    project,
)

ATLAS, EYES = make_atlas(64), make_eyes()
CAMERA, MIDDLE = np.array([0.15, 0.1, 1.2]), np.array([0.0, 0.01, 0.07])
LIGHTS = np.array([[0.5, 0.6, 1.0], [-0.7, 0.2, 1.0], [0.1, -0.6, 1.1], [1.0, 0.1, 0.6]])
SIGMA = 0.02
WITHIN_PX = 0.5
"""How far glints may be off: half of what is asked for. They are three pixels wide, blended from discs of 1.8 mm whose
share of a pixel varies by some percent over them, which moves a centroid by a tenth of a pixel."""


def gaze(yaw, pitch):
    return Rotation.from_euler("YX", [yaw, -pitch], degrees=True).apply(AHEAD)


def moved_head():
    return np.column_stack([Rotation.from_euler("YXZ", [12, -7, 5], degrees=True).as_matrix(), [0.01, 0.02, -0.015]])


def mirrors(eyes=EYES, **choices):
    """An avatar whose eyes do nothing but mirror."""
    avatar = make_avatar(ATLAS, eyes, **choices)
    with torch.no_grad():
        avatar.albedo.zero_()
        avatar.log_roughness.fill_(math.log(SIGMA))
    return avatar


def single_glint(name, looks, head, light, shape):
    """Where an eye shows a light; None if it does in two places, or near the crease."""
    axis, center = head[:, :3] @ looks, head[:, :3] @ CENTERS[name] + head[:, 3]
    found = glint_points(center, axis, shape, CAMERA, light, clear=0.15)
    return found[0] if len(found) == 1 else None


HEAD = {"avatar": "head", "shading": "harmonics", "normals": "viewed", "code_size": 4, "decoder_channels": (4,)}
KINDS = {"lobe per pixel": {"deferred": True}, "lobe per Gaussian": {"deferred": False}, "head": HEAD}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("shape", [usual_shape(0.012), EyeShape(0.0125, 0.0125, 0.0)])
def test_turning_the_gaze_turns_the_glint_as_the_mirror_law_says(kind, shape):
    """For several gazes, lights and a moved head; texels are 1.8 mm, pixels 0.5 mm."""
    loaded = LoadedAvatar(mirrors(make_eyes(shape), **KINDS[kind]), ATLAS)
    head, places = moved_head(), defaultdict(list)
    image = make_image(CAMERA, head[:, :3] @ MIDDLE + head[:, 3], 0.5, 200)
    for looks in (gaze(0, 0), gaze(15, 5), gaze(-20, -8), gaze(25, 10), gaze(-5, 20)):
        for number, light in enumerate(LIGHTS):
            rgb, _ = loaded.render(make_frame(ATLAS, looks, light[None], head), image)
            for name in CENTERS:
                point = single_glint(name, looks, head, light, shape)
                if point is not None:
                    truth = project(image, point)
                    found = centroid(rgb.numpy().mean(-1), truth, 12)
                    assert np.hypot(*(found - truth)) < WITHIN_PX, (name, looks, light)
                    places[name, number].append(truth)
    assert sum(map(len, places.values())) >= 16
    # Between gazes the glint of a light wanders over a cornea, and stays where it is on a sphere.
    wandered = max(np.ptp(found, axis=0).max() for found in places.values())
    assert wandered == pytest.approx(0.0, abs=1e-6) if shape.is_sphere else wandered > 4


def test_glints_at_the_resolution_of_subject_b():
    """Its eyes, in pixels of 2.2 mm: glints are a pixel wide, and still within half a pixel of their places."""
    shape, head, errors = EyeShape(EYE_RADIUS_M, CORNEA_RADIUS_M, CORNEA_OFFSET_M), np.eye(3, 4), []
    loaded = LoadedAvatar(mirrors(make_eyes(shape), **HEAD), ATLAS)
    image = make_image(CAMERA, MIDDLE, 2.2, 48)
    for looks in (gaze(0, 0), gaze(15, 5), gaze(-15, -5), gaze(-5, 12)):
        for light in LIGHTS[:3]:
            rgb, _ = loaded.render(make_frame(ATLAS, looks, light[None]), image)
            for name in CENTERS:
                point = single_glint(name, looks, head, light, shape)
                if point is not None:
                    truth = project(image, point)
                    errors.append(np.hypot(*(centroid(rgb.numpy().mean(-1), truth, 3) - truth)))
    assert len(errors) >= 8 and max(errors) < WITHIN_PX


@pytest.mark.parametrize(("looks", "light"), [(gaze(0, 0), 0), (gaze(15, 5), 0), (gaze(-12, 6), 0), (gaze(5, -9), 2)])
def test_glints_of_the_same_eyes_in_mitsuba(looks, light):
    """Mitsuba's own smooth spheres, of rough metal, under one point light: centroids of the glints and how much light
    is in them, also where a glint is cut by the crease between the spheres."""
    shape, light = usual_shape(0.012), LIGHTS[light]
    image = make_image(CAMERA, MIDDLE, 0.5, 200)
    rgb, _ = LoadedAvatar(mirrors(), ATLAS).render(make_frame(ATLAS, looks, light[None]), image)
    for name, center in CENTERS.items():
        picture = rendered_spheres(image, center, looks, shape, light)
        y, x = np.unravel_index(picture.argmax(), picture.shape)
        brightest = np.array([x, y]) + 0.5
        assert np.hypot(*(brightest - project(image, center))) < 20
        around = (slice(y - 12, y + 13), slice(x - 12, x + 13))
        truth, found = (centroid(values, brightest, 8) for values in (picture, rgb.numpy().mean(-1)))
        clear = glint_points(center, looks, shape, CAMERA, light, clear=0.15)
        assert np.hypot(*(truth - found)) < (WITHIN_PX if clear else 1.0), name
        if clear:
            # A lobe mirrors 2 pi sigma^2 v C / sigma of what metal does; alphas of a few texels are below 1.
            share = 2 * np.pi * SIGMA * START_VISIBILITY * LOBE_CONSTANT * 2.0
            assert rgb.numpy().mean(-1)[around].sum() == pytest.approx(share * picture[around].sum(), rel=0.2)


def rendered_spheres(image, center, axis, shape, light):
    mi = mitsuba()
    world_from_sensor = np.eye(4)
    world_from_sensor[:3, :3] = image.R.T @ np.diag([-1.0, -1.0, 1.0])
    world_from_sensor[:3, 3] = -image.R.T @ image.t
    metal = {"type": "roughconductor", "distribution": "ggx", "alpha": 0.03, "material": "none"}
    cornea = center + shape.cornea_offset_m * axis
    near = project(image, center).astype(int)
    scene = mi.load_dict(
        {
            "type": "scene", "integrator": {"type": "path", "max_depth": 2},
            "eyeball": {"type": "sphere", "center": center.tolist(), "radius": shape.radius_m, "bsdf": metal},
            "cornea": {"type": "sphere", "center": cornea.tolist(), "radius": shape.cornea_radius_m, "bsdf": metal},
            "light": {"type": "point", "position": light.tolist(), "intensity": {"type": "rgb", "value": 1.0}},
            "sensor": {
                "type": "perspective", "fov": float(np.degrees(2 * np.arctan(image.width / 2 / image.K[0, 0]))),
                "fov_axis": "x", "near_clip": 0.01, "to_world": mi.ScalarTransform4f(world_from_sensor),
                "film": {"type": "hdrfilm", "width": image.width, "height": image.height, "rfilter": {"type": "box"},
                         "crop_offset_x": int(near[0]) - 30, "crop_offset_y": int(near[1]) - 30, "crop_width": 60,
                         "crop_height": 60, "pixel_format": "rgb", "component_format": "float32"},
                "sampler": {"type": "independent", "sample_count": 64},
            },
        }
    )  # fmt: skip
    picture = np.zeros((image.height, image.width))
    picture[near[1] - 30 : near[1] + 30, near[0] - 30 : near[0] + 30] = np.array(mi.render(scene, seed=1)).mean(-1)
    return picture


def test_gaussians_stand_on_the_spheres_with_their_normals():
    avatar, head, looks = make_avatar(ATLAS, EYES), moved_head(), gaze(20, -10)
    frame = avatar.prepare(FrameInputs(ATLAS, make_frame(ATLAS, looks, LIGHTS[:1], head)))
    means, normals = frame["means"].detach().numpy(), frame["bent_normals"].detach().numpy()
    shape, axis = usual_shape(0.012), head[:, :3] @ looks
    centers = np.stack([head[:, :3] @ center + head[:, 3] for center in CENTERS.values()])[avatar.eyes.eye]
    from_ball, from_cornea = means - centers, means - centers - shape.cornea_offset_m * axis
    on_ball = np.abs(np.linalg.norm(from_ball, axis=1) / shape.radius_m - 1) < 1e-5
    on_cornea = np.abs(np.linalg.norm(from_cornea, axis=1) / shape.cornea_radius_m - 1) < 1e-5
    assert len(means) == ATLAS.texel_count and (on_ball | on_cornea).all() and on_cornea.sum() > 50
    outward = np.where(on_cornea[:, None], from_cornea, from_ball)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    np.testing.assert_allclose(normals, outward, atol=1e-5)
    axes = frame["axes"].detach().numpy()
    np.testing.assert_allclose(axes[..., 2], outward, atol=1e-5)
    np.testing.assert_allclose(np.einsum("nij,nik->njk", axes, axes), np.tile(np.eye(3), (len(axes), 1, 1)), atol=1e-5)


def test_offsets_turns_and_bent_normals_of_eyes_do_nothing():
    record = make_frame(ATLAS, gaze(5, 5), LIGHTS[:1])
    avatar = make_avatar(ATLAS, EYES)
    before = avatar.prepare(FrameInputs(ATLAS, record))
    with torch.no_grad():
        for name in ("offset", "rotation", "normal_offset"):
            avatar.get_parameter(name).add_(0.1 * torch.randn(avatar.get_parameter(name).shape))
    after = avatar.prepare(FrameInputs(ATLAS, record))
    for name in ("means", "quaternions", "bent_normals"):
        assert torch.equal(before[name], after[name])


def test_gradients_are_those_of_differences_in_float64():
    generator = torch.Generator().manual_seed(0)
    eyes = Eyes(ATLAS, EYES, torch.ones(ATLAS.texel_count, 3)).double()
    head = torch.as_tensor(np.column_stack([moved_head()[:, :3].T, [0.01, 0.02, 0.0]]))
    looks = torch.as_tensor(np.stack([gaze(10, 5), gaze(-8, 2)]))
    with torch.no_grad():
        for parameter in (eyes.shift, eyes.growth, eyes.turn):
            parameter.copy_(0.5 * torch.randn(parameter.shape, generator=generator))

    def posed(*values):
        for name, value in zip(("shift", "growth", "turn"), values, strict=True):
            del eyes._parameters[name]
            setattr(eyes, name, value)
            eyes._parameters[name] = eyes.__dict__.pop(name)
        points, frames = eyes.pose(head, looks)
        return points[::37], frames[::37, :, 2]

    inputs = [getattr(eyes, name).detach().clone().requires_grad_() for name in ("shift", "growth", "turn")]
    assert torch.autograd.gradcheck(posed, inputs, eps=1e-6, atol=1e-8, rtol=1e-6)


def test_traced_glints_have_the_gradients_of_differences_in_float64():
    centers = torch.tensor([[0.0, 0.0, 1.0], [0.02, 0.01, 0.9]], dtype=torch.float64, requires_grad=True)
    radii = torch.tensor([0.12, 0.08], dtype=torch.float64, requires_grad=True)
    x, y = torch.meshgrid(*[torch.linspace(-0.1, 0.1, 9, dtype=torch.float64)] * 2, indexing="ij")
    rays = torch.stack([x, y, torch.ones_like(x)], -1).reshape(-1, 3)
    rays = rays / rays.norm(dim=1, keepdim=True)
    origin = torch.zeros(3, dtype=torch.float64)
    hits, ball, points, normals = trace_spheres(origin, rays, centers, radii)
    assert 20 < len(hits) < len(rays) and set(ball.tolist()) == {0, 1}
    to_center = (points[:, None] - centers).norm(dim=-1)
    assert torch.allclose((to_center - radii).min(1).values, torch.zeros(len(hits), dtype=torch.float64), atol=1e-12)
    assert (normals * rays[hits]).sum(-1).max() < 0
    assert torch.autograd.gradcheck(lambda c, r: trace_spheres(origin, rays, c, r)[2:], (centers, radii))


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


def test_colour_depends_on_the_side_only_once_it_has_learned_to():
    avatar, inputs = make_avatar(ATLAS, EYES), FrameInputs(ATLAS, make_frame(ATLAS, AHEAD, LIGHTS[:1]))
    frame = avatar.prepare(inputs)
    color, sides = frame["diffuse"], [torch.tensor([x, 0.0, 1.0]) for x in (-0.5, 0.5)]
    for side in sides:
        assert torch.equal(avatar.eyes.seen_from(frame, side, color), color)
    seen = [avatar.eyes.seen_from(frame, side, color.detach()).sum() for side in sides]
    (seen[0] - seen[1]).backward()
    gain = avatar.eyes.albedo.last.parametrizations.weight.original0.grad
    assert gain.abs().max() > 0
    with torch.no_grad():
        avatar.eyes.albedo.last.parametrizations.weight.original0.add_(gain.sign())
    left, right = (avatar.eyes.seen_from(frame, side, color).sum() for side in sides)
    assert left > right


def test_losses_are_those_of_the_paper():
    avatar = make_avatar(ATLAS, EYES)
    with torch.no_grad():
        avatar.opacity.fill_(0.0)
        avatar.visibility.fill_(math.log(0.25 / 0.75))
        avatar.log_scale.add_(math.log(1.5))
    frame = avatar.prepare(FrameInputs(ATLAS, make_frame(ATLAS, AHEAD, LIGHTS[:1])))
    terms = regularization(avatar, frame, TrainAvatar())
    assert terms["eye_opacity"].item() == pytest.approx(1e-4 * 0.25, rel=1e-5)
    assert terms["eye_visibility"].item() == pytest.approx(1e-4 * 0.75**2, rel=1e-5)
    scales = 1e3 * frame["scales"].detach()
    excess = (scales - (scales / 1.5).clamp_min(0.1)).clamp_min(0)
    assert terms["eye_scale"].item() == pytest.approx(0.01 * excess.square().mean().item(), rel=1e-4)


def test_without_gaze_or_head_motion_a_frame_is_as_its_mesh_is_posed():
    """Relighting has vertices alone: turned eyeballs say where they look."""
    looks, head = gaze(18, -6), moved_head()
    told = make_frame(ATLAS, looks, LIGHTS[:1], head)
    turn = Rotation.from_euler("YX", [18, 6], degrees=True).as_matrix()
    vertices = ATLAS.rest_vertices.astype(np.float64).copy()
    for name, eye in EYES.items():
        part = list(eye.vertices)
        vertices[part] = (vertices[part] - CENTERS[name]) @ turn.T + CENTERS[name]
    posed = (vertices @ head[:, :3].T + head[:, 3]).astype(np.float32)
    silent = make_avatar(ATLAS, EYES)
    record = told.__class__(**{**told.__dict__, "vertices": posed, "gaze": None})
    expected, found = (silent.prepare(FrameInputs(ATLAS, one))["means"].detach() for one in (told, record))
    assert torch.allclose(expected, found, atol=2e-6)


def test_saved_avatars_come_back_with_their_eyes(tmp_path):
    avatar = mirrors()
    with torch.no_grad():
        avatar.eyes.shift.fill_(0.3)
    write_atlas(tmp_path / "atlas.safetensors", ATLAS)
    save_avatar(tmp_path / "avatar", avatar, {})
    loaded = load_avatar(tmp_path / "avatar", tmp_path / "atlas.safetensors")
    record, image = make_frame(ATLAS, gaze(5, 5), LIGHTS[:1]), make_image(CAMERA, MIDDLE, 1.0, 100)
    pictures = [one.render(record, image)[0] for one in (loaded, LoadedAvatar(avatar, ATLAS))]
    assert pictures[0].max() > 0.1 and torch.equal(*pictures)


def test_training_finds_the_centre_and_the_cornea_from_glints():
    """Pictures of eyes that lie a millimetre elsewhere and have a cornea 6 % larger."""
    true = mirrors()
    with torch.no_grad():
        true.eyes.shift[:, 0], true.eyes.growth[:, 1] = math.atanh(0.5), math.atanh(0.6)
    frames = [make_frame(ATLAS, gaze(*angles), LIGHTS) for angles in ((0, 0), (14, 4), (-14, -4))]
    frames = [FrameInputs(ATLAS, frame) for frame in frames]
    views = [make_image(np.array([x, 0.1, 1.2]), MIDDLE, 1.0, 100) for x in (-0.3, 0.3)]
    avatar = mirrors()
    for name, parameter in avatar.named_parameters():
        parameter.requires_grad_(name in ("eyes.shift", "eyes.growth"))
    parameters = [avatar.eyes.shift, avatar.eyes.growth]
    optimizer = torch.optim.Adam(parameters, lr=0.05)
    for step in range(60):
        inputs = frames[step % 3]
        image = views[step % 2]
        camera = [torch.tensor(array, dtype=torch.float32) for array in (image.R, image.t, image.K)]
        with torch.no_grad():
            wanted = true.view(true.prepare(inputs), *camera, 100, 100)["rgb"]
        found = avatar.view(avatar.prepare(inputs), *camera, 100, 100)["rgb"]
        optimizer.zero_grad()
        blurred(found - wanted).square().sum().backward()
        optimizer.step()
    shift = MOST_SHIFT_M * torch.tanh(avatar.eyes.shift.detach())
    growth = MOST_GROWTH * torch.tanh(avatar.eyes.growth.detach())
    assert torch.allclose(shift[:, 0], torch.full((2,), 1e-3), atol=2.5e-4)
    assert torch.allclose(growth[:, 1], torch.full((2,), 0.06), atol=0.03)


def blurred(picture):
    """By a box of 9 pixels: narrow glints that do not touch have no slope towards each other."""
    return torch.nn.functional.avg_pool2d(picture.permute(2, 0, 1)[None], 9, 1, 4)


def test_a_step_of_training_moves_the_eyes():
    avatar = make_avatar(ATLAS, EYES)
    record = make_frame(ATLAS, gaze(3, 3), LIGHTS)
    image = make_image(CAMERA, MIDDLE, 1.0, 100)
    before = {name: value.detach().clone() for name, value in avatar.eyes.named_parameters()}
    Training(avatar, TrainAvatar(steps=2)).take_step(0, FrameInputs(ATLAS, record), [image])
    moved = {name for name, value in avatar.eyes.named_parameters() if not torch.equal(before[name], value)}
    assert {"shift", "growth", "turn"} <= moved


def test_eyes_that_the_template_has_not_are_named():
    lost = make_eyes()
    lost["eye_l"] = lost["eye_l"].__class__(**{**lost["eye_l"].__dict__, "vertices": (10**6,)})
    with pytest.raises(InputError, match="eye_l: expected vertices 0 to 1283"):
        make_avatar(ATLAS, lost)
    lost["eye_l"] = lost["eye_l"].__class__(**{**lost["eye_l"].__dict__, "vertices": (0, 1)})
    with pytest.raises(InputError, match=r"\['eye_l'\]: expected texels"):
        make_avatar(ATLAS, lost)


def test_eyes_mirror_a_sky_by_lobes_as_by_its_pixels():
    """A smooth sky, brighter from above and from the left: prefiltered panoramas against one light per pixel."""
    latitude, longitude = np.meshgrid(np.linspace(1, -1, 32), np.linspace(-np.pi, np.pi, 64), indexing="ij")
    radiance = 1.2 + latitude[..., None] * [0.8, 0.6, 0.4] + 0.3 * np.sin(longitude)[..., None]
    sky = Environment(radiance.astype(np.float32))
    avatar = mirrors()
    with torch.no_grad():
        avatar.log_roughness.fill_(math.log(0.15))
    relighter, turn = Relighter(LoadedAvatar(avatar, ATLAS), TraceIrradiance()), np.eye(3)
    driver = from_record(make_frame(ATLAS, gaze(10, 5), LIGHTS[:1], moved_head()))
    image = make_image(CAMERA, MIDDLE, 1.0, 100)
    camera = Camera(image.R, image.t, image.K, np.zeros(5), 100, 100)
    lobes = relighter.view(relighter.under_sky(driver, relighter.prepare_sky(sky), sky, turn), camera)[0]
    pixels = relighter.view(relighter.under_pixels(driver, sky, turn), camera)[0]
    seen = pixels.mean(-1) > 0.02
    assert seen.sum() > 500
    # A pixel on the rim mirrors a fifth of the sky, for which both ways take one lobe; inside they agree.
    assert ((lobes - pixels).abs().mean(-1) / pixels.mean(-1))[seen].median() < 0.02
    assert lobes.sum().item() == pytest.approx(pixels.sum().item(), rel=0.1)


def test_driven_eyes_look_where_they_are_told():
    """The gaze is apart from the rest of the pose."""
    relighter = Relighter(LoadedAvatar(mirrors(), ATLAS), TraceIrradiance())
    driver = from_record(make_frame(ATLAS, gaze(0, 0), LIGHTS[:1]))
    told = replace(driver, gaze=np.tile(gaze(15, 5), (2, 1)).astype(np.float32))
    lights = FrameLights(LIGHTS[:1], np.full((1, 3), 2.0))
    expected = LoadedAvatar(mirrors(), ATLAS).avatar.prepare(
        FrameInputs(ATLAS, make_frame(ATLAS, gaze(15, 5), LIGHTS[:1]))
    )
    assert torch.equal(relighter.under_lights(told, lights)["means"], expected["means"])
    assert not torch.equal(relighter.under_lights(driver, lights)["means"], expected["means"])
