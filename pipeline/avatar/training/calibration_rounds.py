"""Refinement of lights and cameras in the course of a training."""

from __future__ import annotations

from functools import partial

from pipeline.avatar.frames.camera_offsets import CAMERAS_AS_CALIBRATED, CameraOffsets, MovedImages
from pipeline.avatar.frames.frame_stream import FrameStream
from pipeline.avatar.frames.light_gains import LightGains
from pipeline.avatar.training.calibration_refinement import frames_to_look_at, images_to_look_at, refine_calibration
from pipeline.avatar.training.isra_albedo import first_portions, isra_round, tells_albedo
from pipeline.avatar.training.light_refinement import Sigmas
from pipeline.avatar.training.read_ahead import ReadAhead, Rounds
from pipeline.avatar.training.training import Position, Training
from pipeline.capture.records import ImageRecord
from pipeline.config.train_avatar import TrainAvatar

REFINED_AFTER = 0.3
"""Share of the steps after which the calibration is refined: the avatar is good enough to judge by, and has time to
follow. At one time: on a recorded body and on a head with 60 lights, a second time found nothing more."""

SETTLED, MOST_ROUNDS = 0.005, 4
"""Change of lights' brightness, RMS, after which they are not looked at again, and how often at most. Of what is wrong
a look finds two thirds, so that half of the last change is left: a quarter of a percent, which no picture shows."""


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
    training: Training, images: MovedImages, frames: FrameStream, rounds: Rounds, ahead: ReadAhead, at: Position
) -> None:
    """Refine the calibration with today's avatar, and go on with what was found.

    Albedo that has learned for a while has taken part of what is wrong with the lights for its own. So where lights
    changed much, and colours tell the albedo, it follows them, and they are looked at again.
    """
    for _ in range(MOST_ROUNDS):
        ahead.wait()
        change = refine_once(training, images, frames, rounds, at)
        if change <= SETTLED or not tells_albedo(training.avatar.spec):
            return
        isra_round(training, first_portions(rounds, ahead))


def refine_once(training: Training, images: MovedImages, frames: FrameStream, rounds: Rounds, at: Position) -> float:
    """Refine lights and cameras from what is known of them.

    Returns:
        How much lights' brightness changed, RMS, beside that of all together.
    """
    processes, places = training.processes, training.settings.steps_together * training.settings.frames_per_step
    schedule, chosen = rounds.schedule, rounds.chosen
    by_frame = {number: [chosen[i] for i in group] for number, group in schedule.by_frame.items()}
    looked_at = frames_to_look_at(frames.records.table, by_frame)
    if not looked_at:
        return 0.0
    sigmas = expected_errors(training.settings)
    # Of lights any images tell; cameras take turns, so that all are seen.
    chosen_of = {n: images_to_look_at(by_frame[n], i if sigmas.shift_m else 0) for i, n in enumerate(looked_at)}
    mine = {n for n in looked_at if processes.rank == processes.sharers(schedule.place[n], places)[0]}
    before = LightGains.from_json(at.light_gains)
    images.move(CAMERAS_AS_CALIBRATED)
    gains, cameras = refine_calibration(
        training.avatar, frames, {n: partial(read_some, images, rows) for n, rows in chosen_of.items()},
        before, sigmas, processes, mine.__contains__,
    )  # fmt: skip
    at.light_gains, at.camera_offsets = gains.as_json(), cameras.as_json()
    apply_refined(frames, images, at)
    change = gains.factors / before.of(gains.positions)
    return float(change.std() / change.mean()) if len(change) else 0.0


def read_some(images: MovedImages, rows: list[int]) -> list[ImageRecord]:
    """Images of some rows."""
    return [images[row] for row in rows]
