"""A log of a training while it runs: rows, curves and pictures."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from jaxtyping import UInt8
from torch.utils.tensorboard import SummaryWriter

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.model import Avatar
from pipeline.avatar.training.checkpoint import camera_view
from pipeline.capture.images import write_png
from pipeline.capture.records import ImageRecord
from pipeline.config.train_avatar import TrainAvatar
from pipeline.metrics.comparison import preview_srgb, side_by_side

log = logging.getLogger("train_avatar")

MOST_PREVIEWS = 40
"""Of one training, about: enough for a film of it, few enough to look through and to keep."""


class TrainingLog:
    """Events for TensorBoard, previews/step_SSSSSS.png, and rows of the log.

    Args:
        out: folder of the avatar.
        image: the training image that previews show.
        frames: its frame among them, lit as training lights it.
        settings: how often.
        first: step from which training goes on; at 0, the previews of an earlier training are removed.
    """

    def __init__(
        self, out: Path, image: ImageRecord, frames: Mapping[int, FrameInputs], settings: TrainAvatar, first: int
    ) -> None:
        self.folder, self.image, self.frames, self.settings = out / "previews", image, frames, settings
        self.spacing = preview_spacing(settings)
        self.events = SummaryWriter(str(out / "events"), purge_step=first)
        if not first:
            for path in self.folder.glob("step_*.png"):
                path.unlink()

    def __enter__(self) -> TrainingLog:
        return self

    def __exit__(self, *error: object) -> None:
        self.events.close()

    def record(self, step: int, seconds: float, values: dict[str, float], avatar: Avatar) -> list[dict]:
        """Write the terms of a step, and a preview after it, where the settings ask for them.

        Args:
            seconds: spent on the training so far.

        Returns:
            The rows of the log that this step adds: one or none.
        """
        last, rows = step == self.settings.steps - 1, []
        if last or step % self.settings.log_every == 0:
            row = {"step": step, "seconds": seconds, "loss": sum(values.values()), **values}
            rows.append(row)
            for name in ("loss", *values):
                self.events.add_scalar(f"loss/{name}" if name in values else name, row[name], step)
        if self.spacing and (last or step % self.spacing == 0):
            picture = preview(step, avatar, self.frames[self.image.frame], self.image)
            if picture is not None:
                write_png(self.folder / f"step_{step:06d}.png", picture)
                self.events.add_image("preview", picture, step, dataformats="HWC")
        return rows


def preview_spacing(settings: TrainAvatar) -> int:
    """Steps between two previews.

    A multiple of the steps between two rows of the log, so that each has its row; 0 for none.
    """
    if not settings.preview_every:
        return 0
    wanted = max(settings.preview_every, settings.steps / MOST_PREVIEWS)
    return settings.log_every * math.ceil(wanted / settings.log_every)


@torch.no_grad()
def preview(
    step: int, avatar: Avatar, inputs: FrameInputs, image: ImageRecord
) -> UInt8[np.ndarray, "height width 3"] | None:
    """Render captured, rendered and error side by side, in sRGB over black.

    None if something is not finite, which the next step tells.
    """
    try:
        rgb = avatar.view(avatar.prepare(inputs), camera_view(image, inputs.device)).rgb
    except ValueError as error:
        log.warning("no preview of step %d: %s", step, error)
        return None
    captured = preview_srgb(image.image * image.mask[..., None])
    rendered = preview_srgb(rgb.cpu().numpy())
    return side_by_side(captured, rendered, f"step {step}, {image.camera}, frame {image.frame}")
