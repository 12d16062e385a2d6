"""Gaze of a frame, as it was declared or as the posed eyes lie."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.geometry.rigid_alignment import align_rigid


def frame_gaze(
    inputs: FrameInputs, parts: Sequence[np.ndarray], axes: Float[Tensor, "eyes 3"]
) -> Float[Tensor, "eyes 3"]:
    """Directions in which the eyes look, in the head's frame, as the record says.

    Where it has none: where the axes of the eyes at rest point once the eyes are as their vertices are posed.

    Args:
        parts: vertices of each eye.
        axes: unit directions of the eyes at rest.
    """
    if inputs.record.gaze is not None:
        return torch.as_tensor(inputs.record.gaze, device=inputs.device)
    rest, posed = (array.astype(np.float64) for array in (inputs.atlas.rest_vertices, inputs.record.vertices))
    turns = torch.as_tensor(np.stack([align_rigid(rest[part], posed[part]).R for part in parts])).to(axes)
    return (inputs.head_from_world[:, :3] @ turns @ axes[..., None])[..., 0]
