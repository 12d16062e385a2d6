"""The training loop: drawing, steps, and states that continue bit for bit.

What step s draws depends on (subject, epoch) alone, and on (subject, step) for a head's code. Adam's state is stored
whole. So a run that was stopped and continued gives the same avatar as one that was not, to the bit on the CPU with as
many processes.
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
from torch import Tensor

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.model import Avatar
from pipeline.avatar.training.checkpoint import camera_view, load_tensors
from pipeline.avatar.training.distributed import FlatGradients, Processes
from pipeline.avatar.training.head_losses import expression_terms
from pipeline.avatar.training.losses import reconstruction, regularization
from pipeline.base.errors import InputError
from pipeline.base.files import written_whole
from pipeline.base.seeds import generator_for
from pipeline.capture.records import ImageRecord
from pipeline.config.train_avatar import TrainAvatar
from pipeline.rendering.splat_conventions import NotFinite

RATE_OF = {
    "albedo": "texture", "log_roughness": "texture", "visibility": "texture", "opacity": "texture",
    "log_gloss": "texture", "log_ggx_width": "texture", "ambient": "texture",
    "transfer_color": "transfer", "transfer_mono": "transfer",
    "log_scale": "shape", "rotation": "shape", "normal_offset": "shape", "offset": "offset",
}  # fmt: skip
"""Which learning rate drives which texel parameter; everything else is a network."""


MOMENTS = ("step", "exp_avg", "exp_avg_sq")
"""What Adam keeps of each parameter."""


def make_optimizer(avatar: Avatar, settings: TrainAvatar) -> torch.optim.Adam:
    """Adam with one rate per kind of parameter."""
    groups: dict[str, list[Tensor]] = defaultdict(list)
    for name, parameter in avatar.named_parameters():
        groups[RATE_OF.get(name, "network")].append(parameter)
    rates = [{"params": group, "lr": getattr(settings, f"learning_rate_{kind}")} for kind, group in groups.items()]
    for group in rates:
        group["start_rate"] = group["lr"]
    return torch.optim.Adam(rates, fused=True)


def compute_loss(
    avatar: Avatar, inputs: FrameInputs, images: Sequence[ImageRecord], settings: TrainAvatar, batch: int,
    step: int = 0, processes: Processes = Processes(), subject: str = "",
) -> dict[str, Tensor]:  # fmt: skip
    """This process's part of the weighted terms of one step.

    The sum of all parts and terms is what is minimised.

    Args:
        avatar: what is trained.
        inputs: the frame of the step.
        images: those that fall to this process; may be none.
        settings: weights.
        batch: number of images of the step, in all processes.
        step: number of the step, which decides some weights.
        processes: share the terms that look at no image.
        subject: seeds, with the step, what is drawn.
    """
    frame = avatar.prepare(inputs, **drawn_expression(avatar, subject, step))
    shared = regularization(avatar, frame, settings, step) | expression_terms(avatar, frame, inputs, settings)
    terms = {name: term / processes.count for name, term in shared.items()}
    device = avatar.albedo.device
    for image in images:
        camera = camera_view(image, device)
        picture = avatar.view(frame, camera)
        captured, mask = (torch.tensor(array, device=device) for array in (image.image, image.mask))
        for name, term in reconstruction(picture, captured, mask, camera, settings).items():
            terms[name] = terms.get(name, 0) + term / batch
    return terms


def drawn_expression(avatar: Avatar, subject: str, step: int) -> dict[str, Tensor]:
    """The noise that a step draws a head's code with. The same in all processes, and after a stop."""
    if not avatar.spec.head:
        return {}
    noise = generator_for(subject, "train_avatar", "code", step).standard_normal(avatar.spec.code_size)
    return {"noise": torch.tensor(noise, dtype=torch.float32, device=avatar.albedo.device)}


class BrokenStep(InputError):
    """A loss or gradient is not finite; the message names the terms and parameters. The step changed nothing."""


@dataclass
class Position:
    """Progress of a training.

    Attributes:
        step: steps that are done.
        seconds: what they took, in all runs.
        rows: of the log.
    """

    step: int = 0
    seconds: float = 0.0
    rows: list[dict] = field(default_factory=list)


@dataclass(frozen=True)
class Part:
    """One process' part of a step, as it tells the others.

    Attributes:
        values: its parts of the weighted terms; terms of pictures are missing where there was none to render.
        stopping: whether it was asked to stop.
        refused: what the splatting found that was not finite.
    """

    values: dict[str, float]
    stopping: bool
    refused: str = ""


class Training:
    """An avatar, its optimiser and its gradients, in one or several processes. `subject` seeds what steps draw."""

    def __init__(
        self, avatar: Avatar, settings: TrainAvatar, processes: Processes = Processes(), subject: str = ""
    ) -> None:
        self.avatar, self.settings, self.processes, self.subject = avatar, settings, processes, subject
        self.optimizer = make_optimizer(avatar, settings)
        self.gradients = FlatGradients(avatar)

    def take_step(
        self, step: int, inputs: FrameInputs, images: Sequence[ImageRecord], batch: int | None = None,
        stopping: bool = False,
    ) -> tuple[dict[str, float], bool]:  # fmt: skip
        """One optimisation step.

        Args:
            step: number of the step, which decides the rates.
            inputs: the frame of the step.
            images: those that fall to this process.
            batch: number of images of the step, in all processes; not given: those are all.
            stopping: whether this process was asked to stop.

        Returns:
            The weighted terms, and whether any process was asked to stop: the same in all of them.

        Raises:
            BrokenStep: in all processes, if a term or a gradient is not finite; parameters and moments stay as they
                were.
        """
        decay = self.settings.final_rate ** (step / self.settings.steps)
        for group in self.optimizer.param_groups:
            group["lr"] = group["start_rate"] * decay
        self.gradients.clear()
        part = self._add_gradients(step, inputs, images, batch or len(images), stopping)
        self.processes.sum_in_place(self.gradients.flat)
        parts = [Part(**one) for one in self.processes.gather(asdict(part))]
        values: dict[str, float] = defaultdict(float)
        for name, value in (item for part in parts for item in part.values.items()):
            values[name] += value
        self._require_finite(values, [part.refused for part in parts if part.refused])
        self.optimizer.step()
        return dict(values), any(part.stopping for part in parts)

    def _add_gradients(
        self, step: int, inputs: FrameInputs, images: Sequence[ImageRecord], batch: int, stopping: bool
    ) -> Part:
        try:
            weighed = (self.settings, batch, step, self.processes, self.subject)
            terms = compute_loss(self.avatar, inputs, images, *weighed)
        except NotFinite as error:  # Told to all processes: they wait for this one's gradients.
            return Part({}, stopping, str(error))
        sum(terms.values()).backward()
        return Part(dict(zip(terms, torch.stack(list(terms.values())).tolist(), strict=True)), stopping)

    def _require_finite(self, values: dict[str, float], refused: list[str]) -> None:
        terms = [f"{name} ({value})" for name, value in values.items() if not math.isfinite(value)]
        parameters = self.gradients.not_finite()
        found = [f"loss terms: {', '.join(terms)}"] * bool(terms)
        found += [f"gradients of: {', '.join(parameters)}"] * bool(parameters)
        found += [f"Gaussians: {reason}" for reason in refused[:1]]
        if found:
            raise BrokenStep(f"expected finite numbers, found others in {'; in '.join(found)}")

    def save(self, path: Path, position: Position, fingerprint: str) -> None:
        """Write parameters, Adam's moments and the position."""
        tensors = {f"avatar.{name}": tensor for name, tensor in self.avatar.state_dict().items()}
        for name, parameter in self.avatar.named_parameters():
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
            for name, parameter in self.avatar.named_parameters():
                state = {key: tensors[f"adam.{key}.{name}"].to(parameter.device) for key in MOMENTS}
                self.optimizer.state[parameter] = state
        return position
