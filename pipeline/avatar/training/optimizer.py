"""Adam over the parameters of an avatar: one learning rate per kind."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn

from pipeline.avatar.model import Avatar
from pipeline.config.train_avatar import TrainAvatar

RATE_OF = {
    "albedo": "texture", "log_roughness": "texture", "visibility": "texture", "opacity": "texture",
    "log_tint": "texture", "log_gloss": "texture", "log_ggx_width": "texture", "ambient": "texture",
    "transfer_color": "transfer", "transfer_mono": "transfer",
    **{f"networks.texels.{name}": "transfer" for name in ("features", "expressed", "mixing", "tables")},
    "subsurface.weight": "texture", "coat.share": "shape",
    "log_scale": "shape", "rotation": "shape", "normal_offset": "shape", "offset": "offset",
}  # fmt: skip
"""Which learning rate drives which texel parameter; everything else is a network."""
EPSILON = 1e-8
"""Added to the root of the mean squared gradient. A gradient per metre is the smaller the larger a subject is."""
MOMENTS = ("step", "exp_avg", "exp_avg_sq")
"""What Adam keeps of each parameter."""


def plain(method: Callable[..., Any]) -> Callable[..., Any]:
    """A method without what was put around it."""
    return getattr(method, "__wrapped__", method)


class Adam(torch.optim.Adam):
    """Adam without torch's compiler.

    Torch's methods import it to tell it to leave them alone, which takes 2 s of a processor at the start of every
    training. Nothing is compiled here.
    """

    add_param_group = plain(torch.optim.Adam.add_param_group)
    step = torch.no_grad()(plain(torch.optim.Adam.step))


def learned_parameters(module: nn.Module) -> dict[str, nn.Parameter]:
    """The parameters that training changes, by name: not those of a geometry that was given."""
    return {name: parameter for name, parameter in module.named_parameters() if parameter.requires_grad}


def make_optimizer(avatar: Avatar, settings: TrainAvatar) -> Adam:
    """Adam with one rate per kind of parameter; that of lengths is in units of `length_unit_m`."""
    groups: dict[str, list[Tensor]] = defaultdict(list)
    for name, parameter in learned_parameters(avatar).items():
        groups[RATE_OF.get(name, "network")].append(parameter)
    rates = [{"params": group, "lr": getattr(settings, f"learning_rate_{kind}")} for kind, group in groups.items()]
    for kind, group in zip(groups, rates, strict=True):
        unit = avatar.unit_m if kind == "offset" else 1.0
        group |= {"lr": unit * group["lr"], "eps": EPSILON / unit}
    for group in rates:
        group["start_rate"] = group["lr"]
    return Adam(rates, fused=True)


def rate_share(step: int, settings: TrainAvatar) -> float:
    """Share of their start that learning rates have at a step.

    They fall exponentially; in the last steps (`cooldown`) to nothing besides, in a straight line, so that what single
    images pull at does not stay in the avatar.
    """
    done = step / settings.steps
    left = min(1.0, (1.0 - done) / settings.cooldown) if settings.cooldown else 1.0
    return settings.final_rate**done * left
