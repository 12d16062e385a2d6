"""Where a frame's head is and where its eyes look: as its record says or, where it does not, as its mesh is posed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.avatar.pose import FrameInputs
from pipeline.geometry.alignment import align_rigid

POINTS = 500
"""Vertices that a head's pose is taken from: of noise or expression in each, a twentieth is left."""


def head_from_world(inputs: FrameInputs, parts: Sequence[np.ndarray]) -> Float[Tensor, "3 4"]:
    """[R | t] that brings points to the frame of the template at rest, metres.

    Where the record has none: of the template's skin, robust to the part of it that an expression moves.

    Args:
        parts: vertices of each eye, which turn by themselves.
    """
    if inputs.record.head_from_world is not None:
        return torch.as_tensor(inputs.record.head_from_world, device=inputs.device)
    rest, posed = inputs.atlas.rest_vertices, inputs.record.vertices
    skin = np.setdiff1d(np.arange(len(rest)), np.concatenate([*parts]))
    some = skin[np.linspace(0, len(skin) - 1, min(len(skin), POINTS)).astype(np.int64)]
    moved = align_rigid(posed[some].astype(np.float64), rest[some].astype(np.float64))
    return torch.as_tensor(np.column_stack([moved.R, moved.t]).astype(np.float32), device=inputs.device)


def gaze_of(inputs: FrameInputs, parts: Sequence[np.ndarray], axes: Float[Tensor, "eyes 3"]) -> Float[Tensor, "eyes 3"]:
    """Directions in which the eyes look, in the head's frame.

    Where the record has none: where the axes of the eyes at rest point once the eyes are as their vertices are posed.
    """
    if inputs.record.gaze is not None:
        return torch.as_tensor(inputs.record.gaze, device=inputs.device)
    rest, posed = (array.astype(np.float64) for array in (inputs.atlas.rest_vertices, inputs.record.vertices))
    turns = np.stack([align_rigid(rest[part], posed[part]).R for part in parts])
    head = head_from_world(inputs, parts)[:, :3]
    return (head @ torch.as_tensor(turns).to(axes) @ axes[..., None])[..., 0]
