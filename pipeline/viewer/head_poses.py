"""Poses of a head that no camera saw: along the axes of its latent code, and of gaze.

Each is placed and traced as a frame is, when the page is written, so that light in the page is as right as for a frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float, Float32
from scipy.spatial.transform import Rotation

from pipeline.avatar.relighting.driving_signal import from_code
from pipeline.avatar.training.checkpoint import LoadedAvatar
from pipeline.capture.records import FrameRecord

FARTHEST_CODE = 2.0
"""Standard deviations of the frames' codes to which an axis goes: one frame in twenty lies beyond."""

GAZE_DEGREES = {"left and right": ("Y", 24.0), "up and down": ("X", 14.0)}
"""Axis in the head's frame about which eyes turn, and how far: half of what eyes can do, where lids still fit."""


@dataclass(frozen=True)
class HeadPose:
    """A pose to be shown.

    Attributes:
        label: as the page names it.
        record: vertices, motion and gaze.
        code: the latent code.
    """

    label: str
    record: FrameRecord
    code: Float32[np.ndarray, " code"]


@dataclass(frozen=True)
class HeadSlider:
    """Poses that a slider stops at, evenly spaced.

    The one in the middle is that of all sliders at rest.

    Attributes:
        name: as the page names it.
        poses: an odd number.
        farthest: where the last stands, and, negative, the first.
        unit: of `farthest`.
    """

    name: str
    poses: Sequence[HeadPose]
    farthest: float
    unit: Literal["standard deviations", "degrees"]


def head_sliders(loaded: LoadedAvatar, records: Sequence[FrameRecord], axes: int, steps: int) -> list[HeadSlider]:
    """Sliders of a head with a latent code; none of a body.

    Expressions, and of a head with explicit eyes its gaze.

    Args:
        loaded: of the avatar.
        records: tracked frames; the head stands as in the first.
        axes: of the latent code, those along which the frames differ most.
        steps: poses of a slider, an odd number.
    """
    spec = loaded.avatar.spec
    if not spec.head or not spec.decoded or steps < 3:
        return []
    codes = np.stack([_code_of(loaded, record) for record in records]).astype(np.float64)
    mean = codes.mean(0)
    _, sizes, directions = np.linalg.svd(codes - mean, full_matrices=False)
    spreads = sizes / np.sqrt(max(1, len(codes) - 1))
    shares, sliders = np.linspace(-1, 1, steps), []
    rest = _posed(loaded, records[0], "at rest", mean, _mean_gaze(records))
    for axis in range(min(axes, int((spreads > 0).sum()))):
        name, poses = f"Expression {axis + 1}", []
        for share in shares:
            offset = FARTHEST_CODE * share
            label = f"{name.lower()}, {offset:+.1f} standard deviations"
            code = mean + offset * spreads[axis] * directions[axis]
            poses.append(_posed(loaded, records[0], label, code, rest.record.gaze) if share else rest)
        sliders.append(HeadSlider(name, poses, FARTHEST_CODE, "standard deviations"))
    for name, (axis, farthest) in GAZE_DEGREES.items() if spec.eyes and rest.record.gaze is not None else ():
        poses = []
        for share in shares:
            turn = Rotation.from_euler(axis, farthest * share, degrees=True)
            looks = turn.apply(rest.record.gaze).astype(np.float32)
            label = f"gaze {name}, {farthest * share:+.0f} degrees"
            poses.append(replace(rest, label=label, record=replace(rest.record, gaze=looks)) if share else rest)
        sliders.append(HeadSlider(f"Gaze {name}", poses, farthest, "degrees"))
    return sliders


@torch.no_grad()
def _code_of(loaded: LoadedAvatar, record: FrameRecord) -> Float32[np.ndarray, " code"]:
    return loaded.avatar.networks.encode(loaded.inputs(record)).mean.numpy()


def _posed(
    loaded: LoadedAvatar, record: FrameRecord, label: str, code: Float[np.ndarray, " code"],
    gaze: Float32[np.ndarray, "eyes 3"] | None,
) -> HeadPose:  # fmt: skip
    signal = from_code(loaded.avatar, code, record.head_from_world)
    placed = replace(record, vertices=signal.vertices.astype(np.float32), gaze=gaze)
    return HeadPose(label, placed, signal.code)


def _mean_gaze(records: Sequence[FrameRecord]) -> Float32[np.ndarray, "eyes 3"] | None:
    """Mean direction of each eye; None if a frame says none."""
    if any(record.gaze is None for record in records):
        return None
    mean = np.stack([record.gaze for record in records]).mean(0)
    return (mean / np.linalg.norm(mean, axis=1, keepdims=True)).astype(np.float32)
