"""Driving signal of an avatar in a picture.

Posed vertices, and of a head also its motion, its mean texture, or a code.

A head is driven from a latent code (`from_code`), from tracked vertices (a plain array, or `from_record`), or by the
expressions of frames of any segment, held still or moved in another way (`from_record` with a motion). The light is
`Relighter`'s to choose. The gaze of explicit eyes is apart from the expression: `replace(signal, gaze=...)`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float, Float32

from pipeline.avatar.model import Avatar
from pipeline.base.errors import InputError
from pipeline.capture.records import FrameRecord

AT_REST = np.eye(3, 4, dtype=np.float32)
"""The motion of a head that stands where its template does."""


@dataclass(frozen=True)
class DrivingSignal:
    """One picture's pose.

    Attributes:
        vertices: posed template in the world, metres.
        head_from_world: as of `FrameRecord`; None: found from the vertices.
        texture: mean texture of the texels, linear RGB, for the encoder; None: that of an average frame.
        code: a head's latent code, in place of what the encoder says; None: encoded.
        gaze: unit direction in which each explicit eye looks, in the head's frame; None: as the eyes' vertices lie.
    """

    vertices: Float[np.ndarray, "vertices 3"]
    head_from_world: Float32[np.ndarray, "3 4"] | None = None
    texture: Float32[np.ndarray, "texels 3"] | None = None
    code: Float32[np.ndarray, " code"] | None = None
    gaze: Float32[np.ndarray, "eyes 3"] | None = None


def as_signal(pose: Float[np.ndarray, "vertices 3"] | DrivingSignal) -> DrivingSignal:
    """Make a driving signal of vertices alone, or keep one as it is."""
    return pose if isinstance(pose, DrivingSignal) else DrivingSignal(pose)


@torch.no_grad()
def from_code(
    avatar: Avatar, code: Float[np.ndarray, " code"], head_from_world: Float[np.ndarray, "3 4"] = AT_REST
) -> DrivingSignal:
    """A head with the expression of a latent code.

    Raises:
        InputError: if the avatar has no code, or one of another size.
    """
    size = avatar.spec.code_size
    if not avatar.spec.head or code.shape != (size,):
        expected = f"a code of {size} numbers" if avatar.spec.head else "the avatar of a head"
        raise InputError(
            f"code: expected {expected}, found {len(code)} numbers for the avatar of a {avatar.spec.avatar}"
        )
    code = code.astype(np.float32)
    local = avatar.networks.expression.vertices(torch.tensor(code, device=avatar.albedo.device)).cpu().numpy()
    return DrivingSignal(moved(local, head_from_world), head_from_world.astype(np.float32), code=code)


def from_record(record: FrameRecord, head_from_world: Float[np.ndarray, "3 4"] | None = None) -> DrivingSignal:
    """The pose of a frame; a head with the frame's expression may move in another way.

    Raises:
        InputError: if it shall, but the frame does not say how its head moved.
    """
    signal = DrivingSignal(record.vertices, record.head_from_world, record.texture, gaze=record.gaze)
    if head_from_world is None:
        return signal
    if signal.head_from_world is None:
        raise InputError(f"frame {record.frame}: expected the motion of a head, found none; only heads move as a whole")
    return moved_as(signal, head_from_world)


def moved_as(signal: DrivingSignal, head_from_world: Float[np.ndarray, "3 4"]) -> DrivingSignal:
    """The same head, its own motion known, moved in another way."""
    tracked = signal.head_from_world.astype(np.float64)
    local = signal.vertices @ tracked[:, :3].T + tracked[:, 3]
    return replace(signal, vertices=moved(local, head_from_world), head_from_world=head_from_world.astype(np.float32))


def moved(
    local: Float[np.ndarray, "vertices 3"], head_from_world: Float[np.ndarray, "3 4"]
) -> Float[np.ndarray, "vertices 3"]:
    """Points of the head's frame in the world, metres: the inverse of x -> R x + t."""
    return (local - head_from_world[:, 3]) @ head_from_world[:, :3]
