"""The networks of RFGCA 3, 4 and 14: a pose becomes a code, the code what every texel adds to its own parameters.

    l_b, l_f = E(K_b, K_f)                      PoseEncoder: body and face points, each moved by its root's inverse
    dt, dR, s, o, z, dn = D_ci(l_b, l_f)        PoseDecoder: does not know the camera
    v = D_cv(l_b, l_f, w_o)                     ViewDecoder: w_o in the frame of each Gaussian

What the decoders say is added to parameters that each texel has anyway, and it starts at zero: a new avatar with
networks is the avatar without them. The texels' own parameters are the untied bias of the decoder's last layer.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
import torch
from jaxtyping import Float, Float32, Int64
from torch import Tensor, nn
from torch.nn.functional import embedding_bag, leaky_relu
from torch.nn.utils.parametrizations import weight_norm

from pipeline.avatar.pose_points import body_points, face_points, pose_offsets
from pipeline.avatar.spec import AvatarSpec
from pipeline.geometry.texels import Atlas

SLOPE = 0.2
"""Of the leaky ReLU below zero (RGCA supplement A)."""

GAIN = math.sqrt(2 / (1 + SLOPE**2))
"""Weights of variance GAIN^2 / inputs keep the size of what passes a leaky ReLU (He et al. 2015)."""

FIRST_SIDE = 8
"""Texels per side of the map that a code is reshaped to; every layer doubles it (RGCA supplement A)."""

TAPS = 4
"""Weights of a 4x4 kernel of stride 2 that reach one output texel, per input channel."""


def linear(inputs: int, outputs: int) -> nn.Linear:
    """A weight-normalised linear layer for what a leaky ReLU follows."""
    layer = nn.Linear(inputs, outputs)
    nn.init.normal_(layer.weight, std=GAIN / math.sqrt(inputs))
    nn.init.zeros_(layer.bias)
    return weight_norm(layer)


class Upsampling(nn.Module):
    """A transposed 4x4 convolution of stride 2, weight-normalised per output channel, with untied bias.

    Args:
        inputs, outputs: channels.
        side: texels per side of its output.
        is_last: no bias of its own, and weights of length zero: its output is zero until it has learned.
    """

    def __init__(self, inputs: int, outputs: int, side: int, is_last: bool = False) -> None:
        super().__init__()
        conv = nn.ConvTranspose2d(inputs, outputs, 4, stride=2, padding=1, bias=False)
        nn.init.normal_(conv.weight, std=GAIN / math.sqrt(TAPS * inputs))
        self.conv = weight_norm(conv, dim=1)
        self.bias = None if is_last else nn.Parameter(torch.zeros(outputs, side, side))
        if is_last:
            nn.init.zeros_(self.conv.parametrizations.weight.original0)

    def forward(self, features: Float[Tensor, "n inputs h w"]) -> Float[Tensor, "n outputs 2*h 2*w"]:
        """Twice the side."""
        out = self.conv(features)
        return out if self.bias is None else out + self.bias


def bilinear(atlas: Atlas, side: int) -> tuple[Int64[np.ndarray, "texels 4"], Float32[np.ndarray, "texels 4"]]:
    """Which four texels of a map of `side` squared, row by row, lie around each texel of an atlas, and their shares."""
    place = ((atlas.texel + 0.5) * (side / atlas.size) - 0.5).clip(0, side - 1)
    low = np.floor(place).astype(np.int64)
    high, share = np.minimum(low + 1, side - 1), (place - low).astype(np.float32)
    rows, columns = (np.stack([low[:, axis], high[:, axis]], 1) for axis in (0, 1))
    down, across = (np.stack([1 - share[:, axis], share[:, axis]], 1) for axis in (0, 1))
    nearest = rows[:, :, None] * side + columns[:, None]
    return nearest.reshape(-1, 4), (down[:, :, None] * across[:, None]).reshape(-1, 4)


class AtlasDecoder(nn.Module):
    """A code to values per texel: a linear layer to 8 x 8, then layers that double it, then bilinear to the atlas.

    Args:
        code: numbers of the code.
        channels: of the map that each layer reads; its number is that of the layers.
        outputs: values per texel.
        starts_at_zero: the last layer is an output, not features.
    """

    def __init__(self, atlas: Atlas, code: int, channels: Sequence[int], outputs: int, starts_at_zero: bool) -> None:
        super().__init__()
        self.start = linear(code, channels[0] * FIRST_SIDE**2)
        self.layers = nn.ModuleList()
        for layer, (inputs, passed) in enumerate(pairwise([*channels, outputs]), 1):
            is_last = starts_at_zero and layer == len(channels)
            self.layers.append(Upsampling(inputs, passed, FIRST_SIDE * 2**layer, is_last))
        nearest, weights = bilinear(atlas, FIRST_SIDE * 2 ** len(channels))
        self.register_buffer("nearest", torch.as_tensor(nearest), persistent=False)
        self.register_buffer("weights", torch.as_tensor(weights), persistent=False)

    def forward(self, code: Float[Tensor, " code"]) -> Float[Tensor, "texels outputs"]:
        """Values of every valid texel."""
        features = self.start(code).reshape(1, -1, FIRST_SIDE, FIRST_SIDE)
        for layer in self.layers:
            features = layer(leaky_relu(features, SLOPE))
        rows = features[0].flatten(1).T.contiguous()
        # Sums of weighted rows; three times as fast as drawing the whole map at the atlas' size.
        return embedding_bag(self.nearest, rows, per_sample_weights=self.weights, mode="sum")


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
    """l_b and l_f beside each other: a body's if the limbs move, a face's if one is declared."""

    def __init__(self, atlas: Atlas, spec: AvatarSpec) -> None:
        super().__init__()
        parts = {}
        if spec.articulation:
            parts["body"] = PoseEncoder(atlas, body_points(atlas, spec.pose_points), spec.code_size)
        if spec.face:
            parts["face"] = PoseEncoder(atlas, face_points(atlas, spec.face, spec.pose_points), spec.code_size)
        self.parts = nn.ModuleDict(parts)
        self.size = max(1, len(parts) * spec.code_size)
        self.register_buffer("constant", torch.ones(1), persistent=False)

    def forward(self, vertices: Float32[np.ndarray, "vertices 3"]) -> Float[Tensor, " code"]:
        """The codes of a posed template; a constant if its pose never changes."""
        codes = [part(vertices) for part in self.parts.values()]
        return torch.cat(codes) if codes else self.constant


class PoseDecoder(nn.Module):
    """D_ci of RFGCA 4: what a pose adds to the parameters of every texel.

    Args:
        atlas: the texels.
        code: numbers of the code.
        channels: see `AtlasDecoder`.
        parameters: the texels' own, by name, [texels, ...].
        units: what a value of 1 adds, where that is not 1.
    """

    def __init__(
        self, atlas: Atlas, code: int, channels: Sequence[int], parameters: Mapping[str, Tensor],
        units: Mapping[str, float],
    ) -> None:  # fmt: skip
        super().__init__()
        self.shapes = {name: tensor.shape for name, tensor in parameters.items()}
        self.units = dict(units)
        self.widths = [math.prod(shape[1:]) for shape in self.shapes.values()]
        self.decoder = AtlasDecoder(atlas, code, channels, sum(self.widths), starts_at_zero=True)

    def forward(self, code: Float[Tensor, " code"]) -> dict[str, Float[Tensor, "texels *_"]]:
        """What is added to each parameter."""
        parts = self.decoder(code).split(self.widths, -1)
        return {
            name: self.units.get(name, 1.0) * part.reshape(shape)
            for (name, shape), part in zip(self.shapes.items(), parts, strict=True)
        }


class ViewDecoder(nn.Module):
    """D_cv of RFGCA 14: what pose and view direction add to the logit of each texel's specular visibility.

    The convolutions do not see the camera, so all cameras of a frame share them; the direction comes in afterwards,
    texel by texel, in the frame of each Gaussian, where nothing blurs it over the charts' borders.
    """

    def __init__(self, atlas: Atlas, code: int, channels: Sequence[int]) -> None:
        super().__init__()
        width = channels[-1]
        self.decoder = AtlasDecoder(atlas, code, channels, width, starts_at_zero=False)
        self.hidden, self.last = linear(width + 3, width), linear(width, 1)
        nn.init.zeros_(self.last.parametrizations.weight.original0)

    def prepare(self, code: Float[Tensor, " code"]) -> Float[Tensor, "texels width"]:
        """What all cameras of a frame share."""
        return self.decoder(code)

    def forward(
        self, shared: Float[Tensor, "texels width"], directions: Float[Tensor, "texels 3"]
    ) -> Float[Tensor, " texels"]:
        """Of one camera: unit directions to it, in the frame of each Gaussian."""
        features = torch.cat([leaky_relu(shared, SLOPE), directions], -1)
        return self.last(leaky_relu(self.hidden(features), SLOPE))[:, 0]
