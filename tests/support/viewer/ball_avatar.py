"""An avatar of Lambert and GGX on a ball over a floor, which shade each other, with all that export_viewer reads."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from pipeline.avatar.model import Avatar
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.avatar.training.checkpoint import save_avatar
from pipeline.base.files import read_arrays, write_table
from pipeline.capture.records import FrameRecord, ImageRecord
from pipeline.capture.shards import write_frame_shard, write_image_shard
from pipeline.geometry.atlas import sampled_atlas
from pipeline.geometry.camera_paths import orbit
from pipeline.geometry.texels import Atlas, read_atlas, write_atlas
from tests.support.captures.posed import write_posed_capture

SPEC = {
    "specular": True, "shadow": True, "shadow_width": 4, "supersample": 2, "dilation_px2": 0.03,
    "pixel_filter": "gaussian", "filter_std_px": 0.5,
    "shading": "microfacet", "visibility": "traced", "indirect": "bounce", "deferred": False, "matte": "coated",
}  # fmt: skip
MIDDLE = np.array([0.0, 1.5, 0.0])
LAMPS = {"key": (2.5, 5.0, 3.0), "rim <b>": (-3.0, 4.0, -1.0), "unlit": (0.0, 6.0, 0.5)}
"""Positions of the stage's lights; the last is on in no frame."""

ACROSS, SIZE = 32, 160
"""Faces of the ball in a row of the map, and its texels a side: three texels a face."""

BRIGHT = (30.0, 28.0, 25.0)


def unfolded_ball(atlas: Atlas) -> Atlas:
    """The same mesh with the ball's faces side by side in the right half of a larger map: each has texels.

    The floor keeps an eighth of the map: large texels say as much about it.
    """
    balls = len(atlas.faces) - 2
    uv, cell = np.array(atlas.uv), np.array([0.5 / ACROSS, ACROSS / balls])
    uv[:2] /= 2
    for k in range(balls):
        row, column = divmod(k, ACROSS)
        corner = np.array([0.5, 0.0]) + cell * (column, row)
        uv[2 + k] = corner + cell * np.array([[0.05, 0.05], [0.05, 0.95], [0.95, 0.05]])
    return sampled_atlas(atlas.rest_vertices, atlas.faces, uv, atlas.weld, SIZE)


def rough_avatar(atlas: Atlas, **spec) -> Avatar:
    """An avatar none of whose texels is like its neighbours."""
    torch.manual_seed(5)
    avatar = Avatar(atlas, texel_spacing(atlas), AvatarSpec(**{**SPEC, **spec}))
    with torch.no_grad():
        avatar.albedo.uniform_(0.2, 0.8)
        avatar.rotation += 0.15 * torch.randn_like(avatar.rotation)
        avatar.offset += 0.003 * torch.randn_like(avatar.offset)
        avatar.log_scale += 0.15 * torch.randn_like(avatar.log_scale)
        avatar.opacity += torch.randn_like(avatar.opacity)
        if avatar.spec.coated:
            avatar.coat.share.fill_(0.4)
        for name, spread in (("normal_offset", 0.1), ("log_ggx_width", 0.3), ("log_gloss", 0.3)):
            if hasattr(avatar, name):
                parameter = getattr(avatar, name)
                parameter += spread * torch.randn_like(parameter)
    return avatar


def write_subject(
    folder: Path, avatar: Avatar, frames: Sequence[FrameRecord], images: Sequence[ImageRecord], built: str
) -> dict[str, Path]:
    """Write all that export_viewer reads of an avatar under `LAMPS`; returns the stage's arguments but `out`."""
    write_atlas(folder / "atlas.safetensors", avatar.atlas)
    write_frame_shard(folder / "shards/frames/0000.arrow", frames)
    for name, some in (("train", images), ("validation", []), ("test", [])):
        write_image_shard(folder / f"shards/{name}/0000.arrow", some)
    places = pd.DataFrame(list(LAMPS.values()), columns=list("xyz"))
    write_table(folder / "lights.parquet", places.assign(light=list(LAMPS)))
    rows = [(frame.frame, name, *BRIGHT) for frame in frames for name in list(LAMPS)[:2]]
    columns = ["frame", "light", "intensity_r", "intensity_g", "intensity_b"]
    write_table(folder / "patterns.parquet", pd.DataFrame(rows, columns=columns))
    save_avatar(folder / "avatar", avatar, {"built": built})
    files = {"atlas": "atlas.safetensors", "lights": "lights.parquet", "patterns": "patterns.parquet"}
    return {name: folder / file for name, file in files.items()} | {
        "avatar": folder / "avatar", "shards": folder / "shards",
    }  # fmt: skip


def write_ball(folder: Path, **spec) -> dict[str, Path]:
    """Write two frames, two cameras' pictures of each, and the avatar; returns the stage's arguments but `out`."""
    paths = write_posed_capture(folder / "capture")
    atlas = unfolded_ball(read_atlas(paths["atlas"]))
    vertices = read_arrays(paths["tracking"])["vertices"][:2]
    vertices[1] += np.float32([0.2, 0, 0]) * (vertices[1][:, 1:2] > 1)
    ones = np.ones(atlas.texel_count, np.float32)
    lit = np.array([LAMPS["key"], LAMPS["rim <b>"]], np.float32)
    bright = np.tile(np.float32(BRIGHT), (2, 1))
    frames = [FrameRecord(10 + i, "a", i == 0, pose, ones, ones, lit, bright) for i, pose in enumerate(vertices)]
    cameras = orbit(MIDDLE, 8.0, 1.0, 0.3, 40.0, 40, 48, 2)
    images = [
        ImageRecord(
            f"cam{k}", frame.frame, False, False, False, False, True, 0, 0, 40, 48,
            np.full((48, 40, 3), 0.2, np.float32),
            np.ones((48, 40), np.float32), camera.K, camera.R, camera.t,
        )
        for frame in frames for k, camera in enumerate(cameras)
    ]  # fmt: skip
    return write_subject(folder, rough_avatar(atlas, **spec), frames, images, "a ball over a floor")
