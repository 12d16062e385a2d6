"""Refinement of lights and cameras in the course of a training."""

from __future__ import annotations

from functools import partial

from pipeline.avatar.frames.camera_offsets import CameraOffsets, MovedImages
from pipeline.avatar.frames.frame_stream import FrameStream
from pipeline.avatar.frames.light_gains import LightGains
from pipeline.avatar.training.calibration_refinement import frames_to_look_at, images_to_look_at, refine_calibration
from pipeline.avatar.training.light_refinement import Sigmas
from pipeline.avatar.training.training import Position, Training
from pipeline.avatar.training.training_images import Schedule
from pipeline.capture.records import ImageRecord
from pipeline.config.train_avatar import TrainAvatar

REFINED_AFTER = 0.3
"""Share of the steps after which the calibration is refined: the avatar is good enough to judge by, and has time to
follow. Once: on a recorded body and on a head with 60 lights, a second time found nothing more."""


def apply_refined(frames: FrameStream, images: MovedImages, at: Position) -> None:
    """Light the frames and see the images by the lights and cameras as they are known by now."""
    frames.relight(LightGains.from_json(at.light_gains))
    images.move(CameraOffsets.from_json(at.camera_offsets))


def expected_errors(settings: TrainAvatar) -> Sigmas:
    """Typical errors of what is refined."""
    return Sigmas(
        gain=settings.light_gain_sigma * settings.refine_lights,
        light_m=settings.light_place_sigma_m * settings.refine_light_places,
        turn=settings.camera_turn_sigma * settings.refine_cameras,
        shift_m=settings.camera_shift_sigma_m * settings.refine_cameras,
    )


def refinement_step(settings: TrainAvatar) -> int | None:
    """Step before which the calibration is refined; None: it never is.

    It is the first of a round.
    """
    if expected_errors(settings) == Sigmas():
        return None
    return round(REFINED_AFTER * settings.steps / settings.steps_together) * settings.steps_together


def refine(
    training: Training, images: MovedImages, chosen: list[int], frames: FrameStream, schedule: Schedule,
    at: Position,
) -> None:  # fmt: skip
    """Refine the calibration with today's avatar, and go on with what was found."""
    processes, places = training.processes, training.settings.steps_together * training.settings.frames_per_step
    by_frame = {number: [chosen[i] for i in group] for number, group in schedule.by_frame.items()}
    looked_at = frames_to_look_at(frames.records.table, by_frame)
    if not looked_at:
        return
    sigmas = expected_errors(training.settings)
    # Of lights any images tell; cameras take turns, so that all are seen.
    chosen_of = {n: images_to_look_at(by_frame[n], i if sigmas.shift_m else 0) for i, n in enumerate(looked_at)}
    mine = {n for n in looked_at if processes.rank == processes.sharers(schedule.place[n], places)[0]}
    gains, cameras = refine_calibration(
        training.avatar, frames, {n: partial(read_some, images, rows) for n, rows in chosen_of.items()},
        LightGains.from_json(at.light_gains), sigmas, processes, mine.__contains__,
    )  # fmt: skip
    at.light_gains, at.camera_offsets = gains.as_json(), cameras.as_json()
    apply_refined(frames, images, at)


def read_some(images: MovedImages, rows: list[int]) -> list[ImageRecord]:
    """Images of some rows."""
    return [images[row] for row in rows]
