"""The loss of one step: weighted terms of a frame and its images, of this process alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.model import Avatar
from pipeline.avatar.training.checkpoint import camera_view
from pipeline.avatar.training.head_losses import expression_terms
from pipeline.avatar.training.losses import reconstruction, regularization, shown_hair
from pipeline.base.seeds import generator_for
from pipeline.capture.records import ImageRecord
from pipeline.config.train_avatar import TrainAvatar


@dataclass(frozen=True)
class Portion:
    """A step of a round, as far as this process does it.

    Attributes:
        inputs: the frame of the step; None if the step is not this process'.
        images: those that fall to this process; may be none.
        batch: number of images of the step, in all processes.
        sharers: number of processes that share the step; they share the terms that look at no image.
        mine: this process is one of them.
    """

    inputs: FrameInputs | None
    images: Sequence[ImageRecord]
    batch: int
    sharers: int = 1
    mine: bool = True


def compute_loss(
    avatar: Avatar, portion: Portion, settings: TrainAvatar, step: int = 0, subject: str = "", images: int = 1,
    drawn: int | None = None,
) -> dict[str, Tensor]:  # fmt: skip
    """This process's part of the weighted terms of one step.

    The sum of all parts and terms is what is minimised.

    Args:
        avatar: what is trained.
        portion: frame and images.
        settings: weights.
        step: number of the step, which decides some weights.
        subject: seeds, with the step, what is drawn.
        images: number of those that the avatar is trained on.
        drawn: number of the draw, where that is not the step's.
    """
    inputs, device = portion.inputs, avatar.albedo.device
    frame = avatar.prepare(inputs, **drawn_expression(avatar, subject, step if drawn is None else drawn))
    shared = regularization(avatar, frame, settings, step, images)
    shared |= expression_terms(avatar, frame, inputs, settings)
    terms = {name: term / portion.sharers for name, term in shared.items()}
    for image in portion.images:
        camera = camera_view(image, device)
        picture = avatar.view(frame, camera)
        captured, mask = (torch.tensor(array, device=device) for array in (image.image, image.mask))
        hair = shown_hair(avatar, frame, camera) if settings.weight_alpha_sparsity else None
        for name, term in reconstruction(picture, captured, mask, camera, settings, hair).items():
            terms[name] = terms.get(name, 0) + term / portion.batch
    return terms


def drawn_expression(avatar: Avatar, subject: str, step: int) -> dict[str, Tensor]:
    """The noise that a step, or a frame of one, draws a head's code with.

    The same in all processes, and after a stop.
    """
    if not avatar.spec.head:
        return {}
    noise = generator_for(subject, "train_avatar", "code", step).standard_normal(avatar.spec.code_size)
    return {"noise": torch.tensor(noise, dtype=torch.float32, device=avatar.albedo.device)}
