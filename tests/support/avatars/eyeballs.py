"""Two eyeballs as a template, planted truth for the tests of explicit eyes."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import torch
import trimesh
from scipy.spatial.transform import Rotation

from pipeline.avatar.model import Avatar
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.capture.records import FrameRecord, ImageRecord
from pipeline.eyes.eye_fit import FittedEye
from pipeline.eyes.eye_shape import EyeShape, usual_shape
from pipeline.geometry.atlas import sampled_atlas, unwrap_faces
from pipeline.geometry.mesh import weld_vertices
from pipeline.geometry.texels import Atlas

CENTERS = {"eye_l": np.array([0.032, 0.010, 0.0625]), "eye_r": np.array([-0.032, 0.010, 0.0625])}
AHEAD = np.array([0.0, 0.0, 1.0])


def make_atlas(size: int, skin: tuple[np.ndarray, np.ndarray] | None = None) -> Atlas:
    """Icospheres of 12 mm for eyes, then the skin (vertices, faces), on a map of `size` squared."""
    ball = trimesh.creation.icosphere(3)
    parts = [(0.012 * np.asarray(ball.vertices) + center, np.asarray(ball.faces)) for center in CENTERS.values()]
    vertices, faces = np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    for points, triangles in [*parts, *([skin] if skin else [])]:
        faces = np.concatenate([faces, triangles + len(vertices)])
        vertices = np.concatenate([vertices, points])
    uv, weld = unwrap_faces(vertices, faces, size, 2), weld_vertices(vertices, faces)
    return sampled_atlas(vertices, faces, uv, weld, size)


def make_eyes(shape: EyeShape = usual_shape(0.012)) -> dict[str, FittedEye]:
    """Both eyes, looking ahead at rest."""
    count = len(trimesh.creation.icosphere(3).vertices)
    return {
        name: FittedEye(
            tuple(center.tolist()), tuple(AHEAD.tolist()), shape, "usual", {}, 0.0, 0.0,
            tuple(range(number * count, (number + 1) * count)),
        )
        for number, (name, center) in enumerate(CENTERS.items())
    }  # fmt: skip


def make_avatar(atlas: Atlas, eyes: dict[str, FittedEye], **choices) -> Avatar:
    """An avatar with eyes, a lobe, and nothing else unless asked for."""
    spec = AvatarSpec(
        **{"specular": True, "shadow": False, "shadow_width": 4, "supersample": 2, "dilation_px2": 0.03,
           "pixel_filter": "gaussian", "filter_std_px": 0.5, "eyes": True} | choices
    )  # fmt: skip
    return Avatar(atlas, texel_spacing(atlas), spec, eyes)


def make_frame(atlas: Atlas, gaze: np.ndarray, lights: np.ndarray, head: np.ndarray | None = None) -> FrameRecord:
    """The template under a head motion (world from head [3, 4]), its eyes along `gaze`.

    The gaze is in the head's frame.
    """
    world = np.eye(3, 4) if head is None else head
    back = np.concatenate([world[:, :3].T, -world[:, :3].T @ world[:, 3:]], 1)
    return FrameRecord(
        frame=0, segment="a", fully_lit=False,
        vertices=(atlas.rest_vertices @ world[:, :3].T + world[:, 3]).astype(np.float32),
        irradiance=np.ones(atlas.texel_count, np.float32), cosine_visibility=np.ones(atlas.texel_count, np.float32),
        light_positions=np.asarray(lights, np.float32), light_intensities=np.full((len(lights), 3), 2.0, np.float32),
        head_from_world=back.astype(np.float32), gaze=np.tile(gaze, (2, 1)).astype(np.float32),
    )  # fmt: skip


def make_image(center: np.ndarray, target: np.ndarray, mm_per_pixel: float, pixels: int) -> ImageRecord:
    """A camera that looks at a point, as sharp as `mm_per_pixel` there."""
    forward = target - center
    distance = np.linalg.norm(forward)
    forward = forward / distance
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(forward, right), forward])
    focal = 1e3 * distance / mm_per_pixel
    K = np.array([[focal, 0, pixels / 2], [0, focal, pixels / 2], [0, 0, 1]])
    return ImageRecord(
        camera="c", frame=0, test_camera=False, test_frame=False, test_segment=False, test_pattern=False,
        fully_lit=False, x0=0, y0=0, width=pixels, height=pixels, image=np.zeros((pixels, pixels, 3), np.float32),
        mask=np.zeros((pixels, pixels), np.float32), K=K, R=R, t=-R @ center,
    )  # fmt: skip


EYES = make_eyes()
CAMERA, MIDDLE = np.array([0.15, 0.1, 1.2]), np.array([0.0, 0.01, 0.07])
LIGHTS = np.array([[0.5, 0.6, 1.0], [-0.7, 0.2, 1.0], [0.1, -0.6, 1.1], [1.0, 0.1, 0.6]])
SIGMA = 0.02
"""Roughness of `mirrors`, radians."""


@cache
def eye_atlas() -> Atlas:
    """Both eyes without skin: made on first use, for xatlas takes a second."""
    return make_atlas(64)


def gaze(yaw: float, pitch: float) -> np.ndarray:
    """A direction so many degrees to the left and up."""
    return Rotation.from_euler("YX", [yaw, -pitch], degrees=True).apply(AHEAD)


def moved_head() -> np.ndarray:
    """A head motion, world from head, [3, 4]."""
    return np.column_stack([Rotation.from_euler("YXZ", [12, -7, 5], degrees=True).as_matrix(), [0.01, 0.02, -0.015]])


def mirrors(eyes: dict[str, FittedEye] = EYES, **choices) -> Avatar:
    """An avatar whose eyes do nothing but mirror, by lobes of width SIGMA."""
    avatar = make_avatar(eye_atlas(), eyes, **choices)
    with torch.no_grad():
        avatar.albedo.zero_()
        if avatar.spec.lobe:
            avatar.log_roughness.fill_(math.log(SIGMA))
        else:
            avatar.log_ggx_width.fill_(math.log(SIGMA / math.sqrt(2)))
    return avatar
