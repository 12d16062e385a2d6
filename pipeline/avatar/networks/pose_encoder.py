"""From a pose to a code of few numbers: the encoder of RFGCA 3."""

from __future__ import annotations

import math

import numpy as np
import torch
from jaxtyping import Float, Float32
from torch import Tensor, nn
from torch.nn.functional import leaky_relu
from torch.nn.utils.parametrizations import weight_norm

from pipeline.avatar.networks.pose_points import FEWEST_POINTS, body_points, face_points, labelled_face, pose_offsets
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.geometry.texels import Atlas

SLOPE = 0.2
"""Of the leaky ReLU below zero (RGCA supplement A)."""

GAIN = math.sqrt(2 / (1 + SLOPE**2))
"""Weights of variance GAIN^2 / inputs keep the size of what passes a leaky ReLU (He et al. 2015)."""


def linear(inputs: int, outputs: int) -> nn.Linear:
    """A weight-normalised linear layer for what a leaky ReLU follows."""
    layer = nn.Linear(inputs, outputs)
    nn.init.normal_(layer.weight, std=GAIN / math.sqrt(inputs))
    nn.init.zeros_(layer.bias)
    return weight_norm(layer)


class PoseEncoder(nn.Module):
    """E of RFGCA 3 for one set of points: two layers on how far each point has moved.

    Args:
        atlas: for its template at rest.
        chosen: the template's vertices that are looked at.
        code: numbers of the code.
    """

    def __init__(self, atlas: Atlas, chosen: np.ndarray, code: int) -> None:
        super().__init__()
        self.register_buffer("chosen", torch.as_tensor(chosen))
        self.rest = atlas.rest_vertices[chosen]
        self.hidden, self.last = linear(3 * len(chosen), code), linear(code, code)

    def forward(self, vertices: Float32[np.ndarray, "vertices 3"]) -> Float[Tensor, " code"]:
        """The code of a posed template, metres."""
        offsets = pose_offsets(self.rest, vertices[self.chosen.cpu().numpy()])
        points = torch.as_tensor(offsets.ravel(), dtype=torch.float32, device=self.chosen.device)
        return leaky_relu(self.last(leaky_relu(self.hidden(points), SLOPE)), SLOPE)


class PoseCode(nn.Module):
    """l_b and l_f beside each other: a body's if the limbs move, a face's if one is known."""

    def __init__(self, atlas: Atlas, spec: AvatarSpec) -> None:
        super().__init__()
        parts = {}
        if spec.articulation:
            parts["body"] = PoseEncoder(atlas, body_points(atlas, spec.pose_points), spec.code_size)
        if spec.face:
            parts["face"] = PoseEncoder(atlas, face_points(atlas, spec.face, spec.pose_points), spec.code_size)
        elif spec.face_code == "labelled":
            found = labelled_face(atlas, spec.pose_points)
            if len(found) >= FEWEST_POINTS:
                parts["face"] = PoseEncoder(atlas, found, spec.code_size)
        self.parts = nn.ModuleDict(parts)
        self.size = max(1, len(parts) * spec.code_size)
        self.register_buffer("constant", torch.ones(1), persistent=False)

    def forward(self, vertices: Float32[np.ndarray, "vertices 3"]) -> Float[Tensor, " code"]:
        """The codes of a posed template; a constant if its pose never changes."""
        codes = [part(vertices) for part in self.parts.values()]
        return torch.cat(codes) if codes else self.constant
