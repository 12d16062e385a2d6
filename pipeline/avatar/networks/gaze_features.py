"""Features of where the eyes look, for the decoders of a head (RGCA 3 and 9, supplement A)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import pad

from pipeline.avatar.frames.gaze import frame_gaze
from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.networks.decoders import FIRST_SIDE
from pipeline.avatar.networks.pose_encoder import linear
from pipeline.base.errors import InputError
from pipeline.eyes.eye_fit import FittedEye
from pipeline.geometry.texels import Atlas

GAZE_CHANNELS = 16
"""Channels that gaze has on the map (RGCA supplement A)."""

BLOCK = 2
"""Side of the block in which an eye's features lie."""


class GazeFeatures(nn.Module):
    """A direction per eye to features on a map of 8 x 8: 16 x 2 x 2 at the eye's place, else 0.

    Args:
        atlas: for the place of each eye.
        eyes: by name; directions come in the order of names.
    """

    def __init__(self, atlas: Atlas, eyes: Mapping[str, FittedEye]) -> None:
        super().__init__()
        names = sorted(eyes)
        if not names:
            raise InputError("gaze_features: expected eyes in eyes.json, found none; set gaze_features: false")
        self.parts = [np.asarray(eyes[name].vertices) for name in names]
        axes = torch.tensor([eyes[name].axis for name in names], dtype=torch.float32)
        self.register_buffer("axes", axes, persistent=False)
        self.places = [block_of(atlas, part) for part in self.parts]
        self.layers = nn.ModuleList(linear(3, GAZE_CHANNELS * BLOCK**2) for _ in names)

    def forward(self, gaze: Float[Tensor, "eyes 3"]) -> Float[Tensor, "16 8 8"]:
        """Features of directions in the head's frame.

        Before the leaky ReLU that decoders begin with. A gaze that is no direction, as behind closed lids, has none.
        """
        length = gaze.norm(dim=-1)
        known = torch.isfinite(length) & (length > 0)
        directions = torch.where(known[:, None], gaze, torch.zeros_like(gaze))
        out = gaze.new_zeros(GAZE_CHANNELS, FIRST_SIDE, FIRST_SIDE)
        for layer, direction, is_known, (row, column) in zip(self.layers, directions, known, self.places, strict=True):
            block = layer(direction).reshape(GAZE_CHANNELS, BLOCK, BLOCK) * is_known
            right, below = FIRST_SIDE - BLOCK - column, FIRST_SIDE - BLOCK - row
            out = out + pad(block, (column, right, row, below))
        return out

    def of_frame(self, inputs: FrameInputs) -> Float[Tensor, "16 8 8"]:
        """Features of a frame's gaze."""
        return self(frame_gaze(inputs, self.parts, self.axes))


def block_of(atlas: Atlas, vertices: np.ndarray) -> tuple[int, int]:
    """Row and column of the block of a map of 8 x 8 that holds most texels of an eye.

    Raises:
        InputError: if the eye has no texel.
    """
    mine = np.isin(atlas.corners, vertices).all(1)
    if not mine.any():
        raise InputError("an eye: expected texels of the atlas on it, found none; make unwrap_atlas.size larger")
    cells = atlas.texel[mine] * FIRST_SIDE // atlas.size
    counts = np.zeros((FIRST_SIDE, FIRST_SIDE))
    np.add.at(counts, tuple(cells.T), 1)
    windows = np.lib.stride_tricks.sliding_window_view(counts, (BLOCK, BLOCK)).sum((2, 3))
    return tuple(int(place) for place in np.unravel_index(windows.argmax(), windows.shape))
