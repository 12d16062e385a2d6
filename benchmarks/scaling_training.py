"""Training jobs of a wanted size for `benchmarks.scaling_cases`: steps of bodies and heads, and what frames hold."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from benchmarks.scaling_inputs import packed
from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.model import Avatar
from pipeline.avatar.spec.planned import read_plan, resolve_spec
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.avatar.training.expression_statistics import learn_expressions
from pipeline.avatar.training.training import Training
from pipeline.capture.records import FrameRecord
from pipeline.capture.shards import ImageShards, read_frame_shards, read_image_shards
from pipeline.config.train_avatar import TrainAvatar
from pipeline.geometry.texels import Atlas, read_atlas

Job = tuple[dict[str, int], Callable[[], object]]
"""How large a job is, by what was counted, and the job."""

STEPS = 2
"""Training steps in one run: neither a tick of the clock nor minutes."""

SETTINGS = TrainAvatar()
"""The defaults."""

HELD_SIDE, HELD_ATLAS = 64, 128
"""Sides of the images and of the atlas where frames are counted: a frame then holds megabytes."""


def training_steps(folder: Path, side: int, atlas_size: int) -> Job:
    """`STEPS` steps of training a body, all on the images of one frame."""
    files = packed(folder, side, atlas_size)
    atlas, images = read_atlas(files["atlas"]), read_image_shards([files["shards"] / "train"])
    records = read_frame_shards([files["shards"] / "frames"])
    inputs = FrameInputs(atlas, records[int(images.table.frame[0])])
    own = [image for image in images if image.frame == inputs.record.frame][: SETTINGS.cameras_per_step]
    training = Training(new_avatar(atlas, files), SETTINGS)

    def run() -> None:
        for step in range(STEPS):
            training.take_step(step, inputs, own)

    return {"texels": atlas.texel_count, "pixels": sum(image.width * image.height for image in own)}, run


def head_steps(folder: Path, atlas_size: int) -> Job:
    """`STEPS` steps of training a head: the scene's frames as expressions of one."""
    files = packed(folder, HELD_SIDE, atlas_size)
    atlas, images = read_atlas(files["atlas"]), read_image_shards([files["shards"] / "train"])
    records = read_frame_shards([files["shards"] / "frames"]).values()
    frames = {record.frame: FrameInputs(atlas, as_head(record, atlas)) for record in records}
    own = by_frame(images, frames)
    avatar = new_avatar(atlas, files, "head")
    learn_expressions(avatar, list(frames.values()))
    training, (first, chosen) = Training(avatar, SETTINGS), next(iter(own.items()))
    pictures = [images[row] for row in chosen]

    def run() -> None:
        for step in range(STEPS):
            training.take_step(step, frames[first], pictures)

    return {"texels": atlas.texel_count, "pixels": sum(image.width * image.height for image in pictures)}, run


def steps_among_frames(folder: Path, count: int) -> Job:
    """`STEPS` steps of training a body, each on the next of so many frames, all of which were visited before."""
    files = packed(folder, HELD_SIDE, HELD_ATLAS, count)
    atlas, images = read_atlas(files["atlas"]), read_image_shards([files["shards"] / "train"])
    avatar = new_avatar(atlas, files)
    frames = visited(avatar, files)
    own, training = by_frame(images, frames), Training(avatar, SETTINGS)
    turn = itertools.cycle(own)

    def run() -> None:
        for step in range(STEPS):
            frame = next(turn)
            training.take_step(step, frames[frame], [images[row] for row in own[frame]])

    chosen = next(iter(own.values()))
    pixels = int((images.table.width * images.table.height).iloc[chosen].sum())
    return {"frames": len(frames), "texels": atlas.texel_count, "pixels": pixels}, run


def held_frames(folder: Path, count: int) -> Job:
    """Frames as training holds them: read, and visited once."""
    files = packed(folder, HELD_SIDE, HELD_ATLAS, count)
    atlas = read_atlas(files["atlas"])
    avatar = new_avatar(atlas, files)
    return {"frames": count, "texels": atlas.texel_count}, lambda: visited(avatar, files)


def new_avatar(atlas: Atlas, files: dict[str, Path], kind: str = "body") -> Avatar:
    """An untrained avatar with the scene's effects."""
    torch.manual_seed(0)
    return Avatar(atlas, texel_spacing(atlas), resolve_spec(SETTINGS, read_plan(files["effects"]), kind))


@torch.no_grad()
def visited(avatar: Avatar, files: dict[str, Path]) -> dict[int, FrameInputs]:
    """All frames, with what a first visit makes of them."""
    records = read_frame_shards([files["shards"] / "frames"]).items()
    frames = {number: FrameInputs(avatar.atlas, record) for number, record in records}
    for inputs in frames.values():
        avatar.prepare(inputs)
    return frames


def by_frame(images: ImageShards, frames: dict[int, FrameInputs]) -> dict[int, list[int]]:
    """Frame -> rows of its images, as many as a step takes."""
    rows = images.table.groupby("frame").groups
    return {frame: rows[frame][: SETTINGS.cameras_per_step].tolist() for frame in frames if frame in rows}


def as_head(record: FrameRecord, atlas: Atlas) -> FrameRecord:
    """The record as one of a head that stands still: what moves is its expression."""
    texture = np.full((atlas.texel_count, 3), 0.3 + 0.1 * (record.frame % 3), np.float32)
    return replace(record, head_from_world=np.eye(3, 4, dtype=np.float32), texture=texture)
