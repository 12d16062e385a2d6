"""Refinement of the lights' brightness in the course of a training."""

from __future__ import annotations

from functools import partial

from pipeline.avatar.frames.frame_stream import FrameStream
from pipeline.avatar.frames.light_gains import LightGains
from pipeline.avatar.training.light_refinement import frames_to_look_at, images_to_look_at, refine_lights
from pipeline.avatar.training.training import Position, Training
from pipeline.avatar.training.training_images import Schedule
from pipeline.capture.records import ImageRecord
from pipeline.capture.shards import ImageShards
from pipeline.config.train_avatar import TrainAvatar

REFINED_AFTER = 0.3
"""Share of the steps after which the brightness of the lights is refined: the avatar is good enough to judge by, and
has time to follow. Once: on a recorded body and on a head with 60 lights, a second time found nothing more."""


def relight(frames: FrameStream, at: Position) -> None:
    """Light the frames by the lights as they are known by now."""
    frames.relight(LightGains.from_json(at.light_gains))


def refinement_step(settings: TrainAvatar) -> int | None:
    """Step before which the brightness of the lights is refined; None: it never is.

    It is the first of a round.
    """
    if not settings.refine_lights:
        return None
    return round(REFINED_AFTER * settings.steps / settings.steps_together) * settings.steps_together


def refine(
    training: Training, images: ImageShards, chosen: list[int], frames: FrameStream, schedule: Schedule,
    at: Position,
) -> None:  # fmt: skip
    """Refine the brightness of the lights with today's avatar, and light the frames by it."""
    processes, places = training.processes, training.settings.steps_together * training.settings.frames_per_step
    by_frame = {number: [chosen[i] for i in group] for number, group in schedule.by_frame.items()}
    looked_at = frames_to_look_at(frames.records.table, by_frame)
    if not looked_at:
        return
    mine = {n for n in looked_at if processes.rank == processes.sharers(schedule.place[n], places)[0]}
    gains = refine_lights(
        training.avatar, frames, {n: partial(read_some, images, by_frame[n]) for n in looked_at},
        LightGains.from_json(at.light_gains), training.settings.light_gain_sigma, processes, mine.__contains__,
    )  # fmt: skip
    at.light_gains = gains.as_json()
    relight(frames, at)


def read_some(images: ImageShards, rows: list[int]) -> list[ImageRecord]:
    """Images to look at of those of a frame."""
    return [images[row] for row in images_to_look_at(rows)]
