"""The training loop: drawing, steps, and states that continue bit for bit.

Steps are taken in rounds: the gradients of a round's steps are all taken at the parameters before it, so that
processes can work on them side by side, and then applied one after the other, in order. So a gradient is late by less
than a round (stale synchronous, Ho et al. 2013), and it does not matter which process took it.

What step s draws depends on (subject, epoch) alone, and on (subject, step) for a head's code. Adam's state is stored
whole. So a run that was stopped and continued gives the same avatar as one that was not, to the bit on the CPU, with
any number of processes that do whole steps.
"""

from __future__ import annotations

import json
import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import safetensors.torch
import torch

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.model import Avatar
from pipeline.avatar.training.checkpoint import load_tensors
from pipeline.avatar.training.distributed import FlatGradients, Processes
from pipeline.avatar.training.optimizer import MOMENTS, learned_parameters, make_optimizer, rate_share
from pipeline.avatar.training.step_loss import Portion, compute_loss
from pipeline.base.errors import InputError
from pipeline.base.files import written_whole
from pipeline.capture.records import ImageRecord
from pipeline.config.train_avatar import TrainAvatar
from pipeline.rendering.splat_conventions import NotFinite


class BrokenStep(InputError):
    """A loss or gradient that is not finite; the message names the terms and parameters. The round changed nothing.

    Args:
        row: place of the step in its round.
    """

    def __init__(self, row: int, message: str) -> None:
        super().__init__(message)
        self.row = row


@dataclass
class Position:
    """Progress of a training.

    Attributes:
        step: steps that are done.
        seconds: what they took, in all runs.
        rows: of the log.
        light_gains: of the lights, as `LightGains.as_json` has them.
        camera_offsets: of the cameras, as `CameraOffsets.as_json` has them.
    """

    step: int = 0
    seconds: float = 0.0
    rows: list[dict] = field(default_factory=list)
    light_gains: list[list[float]] = field(default_factory=list)
    camera_offsets: dict[str, list[float]] = field(default_factory=dict)


@dataclass(frozen=True)
class Part:
    """One process' part of a round, as it tells the others.

    Attributes:
        values: its parts of the weighted terms of each step; empty where it had none.
        refused: what the splatting found in each step that was not finite.
        stopping: whether it was asked to stop.
    """

    values: list[dict[str, float]]
    refused: list[str]
    stopping: bool


class Training:
    """An avatar, its optimiser and its gradients, in one or several processes.

    Args:
        avatar, settings: what is trained, and how.
        processes: this one among all.
        subject: seeds what steps draw.
        images: number of those that the avatar is trained on.
    """

    def __init__(
        self, avatar: Avatar, settings: TrainAvatar, processes: Processes = Processes(), subject: str = "",
        images: int = 1,
    ) -> None:  # fmt: skip
        self.images = images
        self.avatar, self.settings, self.processes, self.subject = avatar, settings, processes, subject
        self.optimizer = make_optimizer(avatar, settings)
        self.frames_per_step = settings.frames_per_step
        self.gradients = FlatGradients(avatar, settings.steps_together * self.frames_per_step)

    def take_step(self, step: int, inputs: FrameInputs, images: Sequence[ImageRecord]) -> dict[str, float]:
        """A round of one step in one process. Returns its weighted terms."""
        return self.take_round(step, [Portion(inputs, images, len(images))])[0][0]

    def take_round(
        self, first: int, portions: Sequence[Portion], stopping: bool = False
    ) -> tuple[list[dict[str, float]], bool]:
        """Several steps from the same parameters.

        Args:
            first: number of the first step, which decides the rates.
            portions: of the frames of the steps, in order, as far as this process does them.
            stopping: whether this process was asked to stop.

        Returns:
            The weighted terms of each step, and whether any process was asked to stop: the same in all of them.

        Raises:
            BrokenStep: in all processes, if a term or a gradient is not finite; parameters and moments stay as they
                were.
        """
        self.gradients.clear()
        done = [self._add_gradients(row, first, portion) for row, portion in enumerate(portions)]
        self.processes.sum_in_place(self.gradients.flat[: len(portions)])
        part = Part([values for values, _ in done], [refused for _, refused in done], stopping)
        parts = [Part(**one) for one in self.processes.gather(asdict(part))]
        rows = [self._summed(row, parts) for row in range(len(portions))]
        starts = range(0, len(portions), self.frames_per_step)
        for step, row in enumerate(starts, first):
            self._apply(row, step)
        return [self._mean(rows[row : row + self.frames_per_step]) for row in starts], any(
            part.stopping for part in parts
        )

    def _mean(self, rows: Sequence[dict[str, float]]) -> dict[str, float]:
        """Terms of a step from those of its frames."""
        return rows[0] if len(rows) == 1 else {name: sum(row[name] for row in rows) / len(rows) for name in rows[0]}

    def _add_gradients(self, row: int, first: int, portion: Portion) -> tuple[dict[str, float], str]:
        """Terms of this process' part of a frame, and what the splatting found that was not finite."""
        if not portion.mine:
            return {}, ""
        self.gradients.point_to(row)
        try:
            step, drawn = first + row // self.frames_per_step, first * self.frames_per_step + row
            terms = compute_loss(self.avatar, portion, self.settings, step, self.subject, self.images, drawn)
        except NotFinite as error:  # Told to all processes: they wait for this one's gradients.
            return {}, str(error)
        sum(terms.values()).backward()
        return dict(zip(terms, torch.stack(list(terms.values())).tolist(), strict=True)), ""

    def _summed(self, row: int, parts: Sequence[Part]) -> dict[str, float]:
        """Terms of a step, summed over the processes, if they and their gradients are finite."""
        values: dict[str, float] = defaultdict(float)
        for name, value in (item for part in parts for item in part.values[row].items()):
            values[name] += value
        terms = [f"{name} ({value})" for name, value in values.items() if not math.isfinite(value)]
        parameters = self.gradients.not_finite(row)
        refused = [part.refused[row] for part in parts if part.refused[row]]
        found = [f"loss terms: {', '.join(terms)}"] * bool(terms)
        found += [f"gradients of: {', '.join(parameters)}"] * bool(parameters)
        found += [f"Gaussians: {reason}" for reason in refused[:1]]
        if found:
            raise BrokenStep(row, f"expected finite numbers, found others in {'; in '.join(found)}")
        return dict(values)

    def _apply(self, row: int, step: int) -> None:
        """Move the parameters by the mean gradient of the frames of a step, which begin at `row`."""
        if self.frames_per_step > 1:
            self.gradients.flat[row] = self.gradients.flat[row : row + self.frames_per_step].mean(0)
        share = rate_share(step, self.settings)
        for group in self.optimizer.param_groups:
            group["lr"] = group["start_rate"] * share
        self.gradients.point_to(row)
        self.optimizer.step()

    def save(self, path: Path, position: Position, fingerprint: str) -> None:
        """Write parameters, Adam's moments and the position."""
        tensors = {f"avatar.{name}": tensor for name, tensor in self.avatar.state_dict().items()}
        for name, parameter in learned_parameters(self.avatar).items():
            tensors |= {f"adam.{key}.{name}": value for key, value in self.optimizer.state[parameter].items()}
        metadata = {"position": json.dumps(asdict(position)), "fingerprint": fingerprint}
        with written_whole(path) as temporary:
            temporary.write_bytes(safetensors.torch.save(tensors, metadata=metadata))

    def restore(self, path: Path, fingerprint: str) -> Position:
        """Put back what `save` wrote and return where it was.

        The start, changing nothing, if the state is missing or another training's.
        """
        if not path.exists():
            return Position()
        tensors, metadata = load_tensors(path)
        if metadata.get("fingerprint") != fingerprint:
            return Position()
        prefix = "avatar."
        self.avatar.load_state_dict({k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)})
        position = Position(**json.loads(metadata["position"]))
        if position.step:  # Before the first step Adam has no moments.
            for name, parameter in learned_parameters(self.avatar).items():
                state = {key: tensors[f"adam.{key}.{name}"].to(parameter.device) for key in MOMENTS}
                self.optimizer.state[parameter] = state
        return position
