"""All steps of a training, with its log, checkpoints and stops."""

from __future__ import annotations

import logging
import signal
import time
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

import torch

from pipeline.avatar.frames.camera_offsets import MovedImages
from pipeline.avatar.frames.frame_stream import FrameStream
from pipeline.avatar.training.calibration_rounds import apply_refined, refine, refinement_step
from pipeline.avatar.training.distributed import Processes
from pipeline.avatar.training.isra_albedo import first_portions, isra_round, starts_from_images
from pipeline.avatar.training.lacking import LookedAt, undrawn_texels
from pipeline.avatar.training.read_ahead import ReadAhead, Rounds
from pipeline.avatar.training.training import BrokenStep, Position, Training
from pipeline.avatar.training.training_images import Schedule
from pipeline.avatar.training.training_log import TrainingLog
from pipeline.base.errors import InputError
from pipeline.base.progress import progress
from pipeline.base.stopping import Stopped, StopRequests

log = logging.getLogger("train_avatar")

CHECKPOINT, BROKEN = "checkpoint.safetensors", "broken.safetensors"
"""States in the avatar's folder: from which a stopped training goes on; before a step that came to nothing."""


def train(
    subject: str, training: Training, images: MovedImages, chosen: list[int], frames: FrameStream, out: Path,
    fingerprint: str,
) -> Position:  # fmt: skip
    """Take all steps that are left after the checkpoint, if there is one, on the chosen images.

    Args:
        subject: seeds the order of the images.
        chosen: places of the images that are trained on.
        frames: inputs of their frames.
        out: the avatar's folder.
        fingerprint: of the work; a checkpoint of other work is not used.

    Raises:
        InputError: if a number is not finite, with the step, its images, what is not, and a state to look at.
        Stopped: after a signal, once the step under way is finished and the checkpoint written.
    """
    settings, processes = training.settings, training.processes
    at = training.restore(out / CHECKPOINT, fingerprint)
    require_same_start(at.step, processes)
    if (out / CHECKPOINT).exists():
        log.info("continuing after %d steps", at.step) if at.step else log.info("checkpoint of other work: not used")
    frame_of_image = images.table.frame.iloc[chosen].tolist()
    in_step = settings.frames_per_step
    schedule = Schedule(subject, frame_of_image, settings.cameras_per_step, settings.steps_together * in_step)
    rounds = Rounds(schedule, chosen, settings)
    apply_refined(frames, images, at)
    looked_at = LookedAt()
    left, before, started = range(at.step, settings.steps), at.seconds, time.monotonic()
    with (
        StopRequests() as stop,
        open_log(out, images, chosen, frames, training, at) as training_log,
        ReadAhead(training.avatar, images, frames, processes) as ahead,
    ):
        if at.step == 0 and starts_from_images(settings, training.avatar.spec):
            isra_round(training, first_portions(rounds, ahead))
        for first in progress(left, "train_avatar") if processes.is_main else left:
            if first < at.step:
                continue  # was done in the round of those before it
            if first == refinement_step(settings):
                refine(training, images, frames, rounds, ahead, at)
            steps, batches = rounds.steps(first), rounds.batches(first)
            portions = ahead.portions(batches)
            ahead.start(rounds.batches(steps.stop))
            looked_at.look(image for portion in portions for image in portion.images)
            try:
                values, stopping = training.take_round(first, portions, bool(stop.received))
            except BrokenStep as error:
                write_state(training, out / BROKEN, at, fingerprint)
                batch = images.table.iloc[batches[error.row]]
                names = ", ".join(f"{row.camera}/{row.frame}" for row in batch.itertuples())
                raise InputError(
                    f"step {steps[error.row // in_step]}, {names}: {error}; before it: {out / BROKEN}"
                ) from error
            at.step, at.seconds = steps[-1] + 1, before + time.monotonic() - started
            if training_log:
                for step, terms in zip(steps, values, strict=True):
                    at.rows += training_log.record(step, at.seconds, terms, training.avatar)
            due = at.step // settings.checkpoint_every > first // settings.checkpoint_every
            if at.step < settings.steps and (stopping or due):
                write_state(training, out / CHECKPOINT, at, fingerprint)
                if stopping:
                    done = f"stopped after {at.step} of {settings.steps} steps; the same command goes on from there"
                    raise Stopped(done, stop.received or signal.SIGTERM)
    if processes.is_main:
        warn_of(looked_at.lacking() + undrawn_texels(training.avatar, training.optimizer))
    return at


def warn_of(lacks: list[str]) -> None:
    """Log what the training images do not tell."""
    for lack in lacks:
        log.warning("%s", lack)


def require_same_start(step: int, processes: Processes) -> None:
    """Refuse processes that do not all go on from the same step.

    Raises:
        InputError: if the processes do not all go on from the same step, for want of a common folder.
    """
    steps = torch.tensor([step * (rank == processes.rank) for rank in range(processes.count)], device=processes.device)
    processes.sum_in_place(steps)
    if len(set(steps.tolist())) > 1:
        raise InputError(
            f"{CHECKPOINT}: expected the same for all processes, found steps {steps.tolist()}; share --out"
        )


def open_log(
    out: Path, images: MovedImages, chosen: list[int], frames: FrameStream, training: Training, at: Position
) -> AbstractContextManager[TrainingLog | None]:
    """Log of the training, kept by the main process, with previews of its middle image.

    That is a fully lit one if there is any.
    """
    if not training.processes.is_main:
        return nullcontext()
    shown = [i for i in chosen if images.table.fully_lit.iloc[i]] or chosen
    image = images[shown[len(shown) // 2]]
    return TrainingLog(out, image, frames, training.settings, at.step)


def write_state(training: Training, path: Path, at: Position, fingerprint: str) -> None:
    """Write the state in the main process.

    All go on once it has, so that none ends, and has the others ended, before.
    """
    if training.processes.is_main:
        training.save(path, at, fingerprint)
    training.processes.wait()
