"""What explicit eyes mirror: glints where the mirror law says, and as Mitsuba renders them."""

from collections import defaultdict

import numpy as np
import pytest
import torch

from benchmarks.mirror_glints import centroid, glint_points, project
from pipeline.avatar.eyes.corneal_reflections import trace_spheres
from pipeline.avatar.eyes.explicit_eyes import START_VISIBILITY
from pipeline.avatar.training.checkpoint import LoadedAvatar
from pipeline.eyes.eye_shape import EyeShape, usual_shape
from pipeline.lighting.lobes import LOBE_CONSTANT
from pipeline.lighting.reflection_kernels import DIELECTRIC_F0
from pipeline.synthesis.eyeball import CORNEA_OFFSET_M, CORNEA_RADIUS_M, EYE_RADIUS_M
from pipeline.synthesis.mitsuba_scenes import mitsuba
from tests.support.avatars.eyeballs import (
    CAMERA,
    CENTERS,
    LIGHTS,
    MIDDLE,
    SIGMA,
    eye_atlas,
    gaze,
    make_eyes,
    make_frame,
    make_image,
    mirrors,
    moved_head,
)

WITHIN_PX = 0.5
"""How far glints may be off: half of what is asked for. They are three pixels wide, blended from discs of 1.8 mm whose
share of a pixel varies by some percent over them, which moves a centroid by a tenth of a pixel."""

HEAD = {"avatar": "head", "shading": "harmonics", "normals": "viewed", "code_size": 4, "decoder_channels": (4,)}
GGX = {"shading": "microfacet"}
KINDS = {"lobe per pixel": {"deferred": True}, "lobe per Gaussian": {"deferred": False}, "head": HEAD, "ggx": GGX}


def single_glint(name, looks, head, light, shape):
    """Where an eye shows a light; None if it does in two places, or near the crease."""
    axis, center = head[:, :3] @ looks, head[:, :3] @ CENTERS[name] + head[:, 3]
    found = glint_points(center, axis, shape, CAMERA, light, clear=0.15)
    return found[0] if len(found) == 1 else None


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("shape", [usual_shape(0.012), EyeShape(0.0125, 0.0125, 0.0)])
def test_turning_the_gaze_turns_the_glint_as_the_mirror_law_says(kind, shape):
    """For several gazes, lights and a moved head; texels are 1.8 mm, pixels 0.5 mm."""
    loaded = LoadedAvatar(mirrors(make_eyes(shape), **KINDS[kind]), eye_atlas())
    head, places = moved_head(), defaultdict(list)
    image = make_image(CAMERA, head[:, :3] @ MIDDLE + head[:, 3], 0.5, 200)
    for looks in (gaze(0, 0), gaze(15, 5), gaze(-20, -8), gaze(25, 10), gaze(-5, 20)):
        for number, light in enumerate(LIGHTS):
            rgb, _ = loaded.render(make_frame(eye_atlas(), looks, light[None], head), image)
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
    loaded = LoadedAvatar(mirrors(make_eyes(shape), **HEAD), eye_atlas())
    image = make_image(CAMERA, MIDDLE, 2.2, 48)
    for looks in (gaze(0, 0), gaze(15, 5), gaze(-15, -5), gaze(-5, 12)):
        for light in LIGHTS[:3]:
            rgb, _ = loaded.render(make_frame(eye_atlas(), looks, light[None]), image)
            for name in CENTERS:
                point = single_glint(name, looks, head, light, shape)
                if point is not None:
                    truth = project(image, point)
                    errors.append(np.hypot(*(centroid(rgb.numpy().mean(-1), truth, 3) - truth)))
    assert len(errors) >= 8 and max(errors) < WITHIN_PX


@pytest.mark.parametrize("kind", [{}, GGX])
@pytest.mark.parametrize(("looks", "light"), [(gaze(0, 0), 0), (gaze(15, 5), 0), (gaze(-12, 6), 0), (gaze(5, -9), 2)])
def test_glints_of_the_same_eyes_in_mitsuba(looks, light, kind):
    """Mitsuba's own smooth spheres, of rough metal, under one point light: centroids of the glints and how much light
    is in them, also where a glint is cut by the crease between the spheres."""
    shape, light = usual_shape(0.012), LIGHTS[light]
    image = make_image(CAMERA, MIDDLE, 0.5, 200)
    rgb, _ = LoadedAvatar(mirrors(**kind), eye_atlas()).render(make_frame(eye_atlas(), looks, light[None]), image)
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
            # A lobe mirrors 2 pi sigma^2 v C / sigma of what metal does, GGX a dielectric's F0; alphas of a few texels
            # are below 1.
            lobe = 2 * np.pi * SIGMA * START_VISIBILITY * LOBE_CONSTANT
            share = 2.0 * (DIELECTRIC_F0 if kind else lobe)
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
