"""Where explicit eyes look and what lights them, told apart from the rest: relighting and driving."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.relighting.driving_signal import from_record
from pipeline.avatar.relighting.film import Relighter
from pipeline.avatar.training.checkpoint import LoadedAvatar
from pipeline.config.trace_irradiance import TraceIrradiance
from pipeline.geometry.cameras import Camera
from pipeline.lighting.environment import Environment
from pipeline.lighting.frame_lights import FrameLights
from tests.support.avatars.eyeballs import (
    CAMERA,
    CENTERS,
    EYES,
    LIGHTS,
    MIDDLE,
    eye_atlas,
    gaze,
    make_avatar,
    make_frame,
    make_image,
    mirrors,
    moved_head,
)


def test_without_gaze_or_head_motion_a_frame_is_as_its_mesh_is_posed():
    """Relighting has vertices alone: turned eyeballs say where they look."""
    looks, head = gaze(18, -6), moved_head()
    told = make_frame(eye_atlas(), looks, LIGHTS[:1], head)
    turn = Rotation.from_euler("YX", [18, 6], degrees=True).as_matrix()
    vertices = eye_atlas().rest_vertices.astype(np.float64).copy()
    for name, eye in EYES.items():
        part = list(eye.vertices)
        vertices[part] = (vertices[part] - CENTERS[name]) @ turn.T + CENTERS[name]
    posed = (vertices @ head[:, :3].T + head[:, 3]).astype(np.float32)
    silent = make_avatar(eye_atlas(), EYES)
    record = told.__class__(**{**told.__dict__, "vertices": posed, "gaze": None})
    expected, found = (silent.prepare(FrameInputs(eye_atlas(), one)).gaussians.means.detach() for one in (told, record))
    assert torch.allclose(expected, found, atol=2e-6)


def test_eyes_mirror_a_sky_by_lobes_as_by_its_pixels():
    """A smooth sky, brighter from above and from the left: prefiltered panoramas against one light per pixel."""
    latitude, longitude = np.meshgrid(np.linspace(1, -1, 32), np.linspace(-np.pi, np.pi, 64), indexing="ij")
    radiance = 1.2 + latitude[..., None] * [0.8, 0.6, 0.4] + 0.3 * np.sin(longitude)[..., None]
    sky = Environment(radiance.astype(np.float32))
    avatar = mirrors()
    with torch.no_grad():
        avatar.log_roughness.fill_(math.log(0.15))
    relighter, turn = Relighter(LoadedAvatar(avatar, eye_atlas()), TraceIrradiance()), np.eye(3)
    driver = from_record(make_frame(eye_atlas(), gaze(10, 5), LIGHTS[:1], moved_head()))
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
    relighter = Relighter(LoadedAvatar(mirrors(), eye_atlas()), TraceIrradiance())
    driver = from_record(make_frame(eye_atlas(), gaze(0, 0), LIGHTS[:1]))
    told = replace(driver, gaze=np.tile(gaze(15, 5), (2, 1)).astype(np.float32))
    lights = FrameLights(LIGHTS[:1], np.full((1, 3), 2.0))
    expected = LoadedAvatar(mirrors(), eye_atlas()).avatar.prepare(
        FrameInputs(eye_atlas(), make_frame(eye_atlas(), gaze(15, 5), LIGHTS[:1]))
    )
    assert torch.equal(relighter.under_lights(told, lights).gaussians.means, expected.gaussians.means)
    assert not torch.equal(relighter.under_lights(driver, lights).gaussians.means, expected.gaussians.means)
