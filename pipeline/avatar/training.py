"""The training loop: what is drawn at each step, the step itself, and states that continue bit for bit.

What step s draws depends on (subject, epoch) alone and Adam's state is stored whole, so a run that was stopped and
continued gives the same avatar as one that was not, to the bit on the CPU.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import safetensors.torch
import torch
from torch import Tensor

from pipeline.avatar.checkpoint import camera_tensors, load_tensors
from pipeline.avatar.losses import reconstruction, regularization
from pipeline.avatar.model import Avatar
from pipeline.avatar.pose import FrameInputs
from pipeline.base.errors import InputError
from pipeline.base.files import written_whole
from pipeline.base.seeds import generator_for
from pipeline.capture.records import ImageRecord
from pipeline.config.train_avatar import TrainAvatar

RATE_OF = {
    "albedo": "texture", "log_roughness": "texture", "visibility": "texture", "opacity": "texture",
    "log_gloss": "texture", "log_ggx_width": "texture", "ambient": "texture",
    "transfer_color": "transfer", "transfer_mono": "transfer",
    "log_scale": "shape", "rotation": "shape", "normal_offset": "shape", "offset": "offset",
}  # fmt: skip
"""Which learning rate drives which texel parameter; everything else is a network."""


class Schedule:
    """Which images each step sees: every epoch all frames in random order, their cameras in random groups."""

    def __init__(self, subject: str, frame_of_image: Sequence[int], cameras_per_step: int) -> None:
        self.subject, self.cameras_per_step = subject, cameras_per_step
        self.by_frame: dict[int, list[int]] = defaultdict(list)
        for index, frame in enumerate(frame_of_image):
            self.by_frame[frame].append(index)
        self.steps_per_epoch = sum(-(-len(group) // cameras_per_step) for group in self.by_frame.values())
        self.epoch = lru_cache(maxsize=2)(self._epoch)

    def _epoch(self, epoch: int) -> list[list[int]]:
        generator = generator_for(self.subject, "train_avatar", epoch)
        groups = []
        for frame in sorted(self.by_frame):
            shuffled = generator.permutation(self.by_frame[frame]).tolist()
            groups += [shuffled[i : i + self.cameras_per_step] for i in range(0, len(shuffled), self.cameras_per_step)]
        return [groups[i] for i in generator.permutation(len(groups))]

    def __getitem__(self, step: int) -> list[int]:
        """Indices of the images of one step; all belong to one frame."""
        epoch, position = divmod(step, self.steps_per_epoch)
        return self.epoch(epoch)[position]


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
    avatar: Avatar, inputs: FrameInputs, images: Sequence[ImageRecord], settings: TrainAvatar, step: int = 0
) -> dict[str, Tensor]:
    """Weighted terms of one step; their sum is what is minimised."""
    frame = avatar.prepare(inputs)
    terms = regularization(avatar, frame, settings, step)
    share = 1 / len(images)
    for image in images:
        R, t, K = camera_tensors(image)
        picture = avatar.view(frame, R, t, K, image.width, image.height)
        captured, mask = torch.tensor(image.image), torch.tensor(image.mask)
        for name, term in reconstruction(picture, captured, mask, R, K, settings).items():
            terms[name] = terms.get(name, 0) + share * term
    return terms


def take_step(
    step: int, avatar: Avatar, optimizer: torch.optim.Adam, inputs: FrameInputs, images: Sequence[ImageRecord],
    settings: TrainAvatar,
) -> dict[str, float]:  # fmt: skip
    """One optimisation step; returns the weighted terms.

    Raises:
        InputError: if a term is not finite, naming it with the images of the step.
    """
    decay = settings.final_rate ** (step / settings.steps)
    for group in optimizer.param_groups:
        group["lr"] = group["start_rate"] * decay
    terms = compute_loss(avatar, inputs, images, settings, step)
    values = {name: term.item() for name, term in terms.items()}
    broken = [name for name, value in values.items() if not torch.isfinite(torch.tensor(value))]
    if broken:
        seen = ", ".join(f"{image.camera}/{image.frame}" for image in images)
        raise InputError(f"step {step}: loss terms {', '.join(broken)} are not finite on images {seen}")
    optimizer.zero_grad(set_to_none=True)
    sum(terms.values()).backward()
    optimizer.step()
    return values


def save_state(
    path: Path, step: int, rows: list[dict], fingerprint: str, avatar: Avatar, optimizer: torch.optim.Adam
) -> None:
    """Write parameters and Adam's moments after `step` steps, and the rows of the log so far."""
    tensors = {f"avatar.{name}": tensor for name, tensor in avatar.state_dict().items()}
    for name, parameter in avatar.named_parameters():
        tensors |= {f"adam.{key}.{name}": value for key, value in optimizer.state[parameter].items()}
    metadata = {"step": str(step), "rows": json.dumps(rows), "fingerprint": fingerprint}
    with written_whole(path) as temporary:
        temporary.write_bytes(safetensors.torch.save(tensors, metadata=metadata))


def restore_state(path: Path, fingerprint: str, avatar: Avatar, optimizer: torch.optim.Adam) -> tuple[int, list[dict]]:
    """Put back what `save_state` wrote and return its step and rows; 0 and none, changing nothing, if the state is
    missing or another training's."""
    if not path.exists():
        return 0, []
    tensors, metadata = load_tensors(path)
    if metadata.get("fingerprint") != fingerprint:
        return 0, []
    prefix = "avatar."
    avatar.load_state_dict({k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)})
    for name, parameter in avatar.named_parameters():
        keys = ("step", "exp_avg", "exp_avg_sq")
        optimizer.state[parameter] = {key: tensors[f"adam.{key}.{name}"] for key in keys}
    return int(metadata["step"]), json.loads(metadata["rows"])
