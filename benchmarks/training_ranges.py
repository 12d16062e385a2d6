"""Ranges of a training step in a profile, and whose the time in it is.

A range is put around functions of the model, not of the training loop. The backward pass of an operation belongs to the
innermost range in which its forward pass ran: the profiler gives both the same sequence number. Ranges that run within
the backward pass, those of kernels, come before that.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any
from unittest import mock

import torch
from torch.autograd.profiler_util import FunctionEvent

from pipeline.avatar.appearance import lobes
from pipeline.avatar.appearance.ggx_gloss import GgxGloss
from pipeline.avatar.appearance.indirect_light import OneBounce
from pipeline.avatar.appearance.lambert import Lambert
from pipeline.avatar.appearance.normals import GaussianNormals, MeshNormals, TangentNormals
from pipeline.avatar.appearance.unturned_harmonics import UnturnedHarmonics
from pipeline.avatar.appearance.zonal_transfer import ZonalTransfer
from pipeline.avatar.frames import inputs, light_fields
from pipeline.avatar.geometry.gaussians_on_texels import GaussiansOnTexels
from pipeline.avatar.model import Avatar
from pipeline.avatar.networks import head_networks
from pipeline.avatar.networks.body_networks import BodyNetworks
from pipeline.avatar.networks.head_networks import HeadNetworks
from pipeline.avatar.networks.shadow_net import ShadowNet
from pipeline.avatar.training import step_loss
from pipeline.avatar.training.distributed import FlatGradients
from pipeline.capture.shards import ImageShards
from pipeline.rendering import splat, supersample

REST, ADAM, SUMMED = "rest", "Adam", "summing gradients"
"""Parts without a range of their own here."""

MARKED: tuple[tuple[object, str, str], ...] = (
    (ImageShards, "__getitem__", "reading images"),
    (inputs, "pose_texels", "posing"),
    (head_networks, "pose_texels", "posing"),
    (GaussiansOnTexels, "place", "posing"),
    (BodyNetworks, "decode", "networks"),
    (BodyNetworks, "viewed", "networks"),
    (HeadNetworks, "decode", "networks"),
    (HeadNetworks, "viewed", "networks"),
    (MeshNormals, "bend", "normals"),
    (TangentNormals, "bend", "normals"),
    (GaussianNormals, "bend", "normals"),
    (light_fields, "gather_light", "gathering light"),
    (light_fields, "gather_distant", "gathering light"),
    (ZonalTransfer, "shade", "transfer"),
    (UnturnedHarmonics, "shade", "transfer"),
    (Lambert, "shade", "Lambert"),
    (GgxGloss, "texel_light", "gloss"),
    (OneBounce, "shade", "bounce"),
    (ShadowNet, "forward", "shadow network"),
    (Avatar, "layers", "stacking layers"),
    (Avatar, "draw", "around splatting"),
    (splat, "project", "projecting"),
    (splat, "project_backward", "projecting"),
    (splat, "depth_order", "sorting into tiles"),
    (splat, "list_tiles", "sorting into tiles"),
    (splat, "blend", "blending"),
    (splat, "blend_backward", "blending"),
    (supersample, "filter_down", "filtering to pixels"),
    (Avatar, "shade_pixels", "deferred lobe"),
    (lobes, "depth_of_pixels", "depth of pixels"),
    (step_loss, "regularization", "losses"),
    (step_loss, "expression_terms", "losses"),
    (step_loss, "reconstruction", "losses"),
    (FlatGradients, "clear", "checking gradients"),
    (FlatGradients, "not_finite", "checking gradients"),
)
"""Owner and name of a function, and the part that it belongs to."""

PREFIX = "part: "
"""Of the ranges' names in the profile."""

OPTIMIZER, BACKWARD = "Optimizer.step", "autograd::engine::evaluate_function"
"""How the names of torch's own ranges begin: around a step of an optimiser, and around each node's backward."""

LEAF = "AccumulateGrad"
"""In the name of the node that adds to a parameter's gradient; it has no forward pass."""


@dataclass(frozen=True)
class Part:
    """A part of a step, forward or backward."""

    name: str
    backward: bool


@contextmanager
def marked() -> Iterator[None]:
    """Put the ranges around all functions of `MARKED`."""
    with ExitStack() as stack:
        for owner, name, part in MARKED:
            stack.enter_context(mock.patch.object(owner, name, within(PREFIX + part, getattr(owner, name))))
        yield


def within(label: str, function: Callable[..., Any]) -> Callable[..., Any]:
    """A function that runs in a range of that name."""

    def ranged(*arguments: Any, **words: Any) -> Any:
        with torch.profiler.record_function(label):
            return function(*arguments, **words)

    return ranged


def seconds_of_parts(events: Iterable[FunctionEvent]) -> dict[Part, float]:
    """Seconds by part: of each event the time that is not its children's."""
    in_order = sorted(events, key=lambda event: event.time_range.start)
    owner_of: dict[int, str] = {}
    for event in in_order:
        if event.sequence_nr >= 0 and not any(one.name.startswith(BACKWARD) for one in lineage(event)):
            # Operations without gradient bear the number of the next one with: the last to bear it made the node.
            owner_of[event.sequence_nr] = innermost(event) or REST
    seconds: dict[Part, float] = defaultdict(float)
    for event in in_order:
        node = next((one for one in lineage(event) if one.name.startswith(BACKWARD)), None)
        own = innermost(event)
        if own is None and node is not None:
            own = SUMMED if LEAF in node.name else owner_of.get(node.sequence_nr)
        seconds[Part(own or REST, node is not None)] += event.self_cpu_time_total / 1e6
    return dict(seconds)


def innermost(event: FunctionEvent) -> str | None:
    """The part of the innermost range around an event."""
    for one in lineage(event):
        if one.name.startswith(PREFIX):
            return one.name.removeprefix(PREFIX)
        if one.name.startswith(OPTIMIZER):
            return ADAM
    return None


def lineage(event: FunctionEvent) -> Iterator[FunctionEvent]:
    """The event, what it ran in, and so on."""
    one: FunctionEvent | None = event
    while one is not None:
        yield one
        one = one.cpu_parent
