"""Decoders from a pose's code to additions to texels' parameters (RFGCA 4 and 14).

Transposed convolutions on the atlas (RGCA supplement A), whose last layer starts at zero. It has no bias: what stands
for its untied bias are the parameters that each texel has anyway.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from types import MappingProxyType

import numpy as np
import torch
from jaxtyping import Float, Float32, Int, Int64
from torch import Tensor, nn
from torch.nn.functional import embedding_bag, leaky_relu
from torch.nn.utils.parametrizations import weight_norm

from pipeline.avatar.networks.pose_encoder import GAIN, SLOPE, linear
from pipeline.geometry.texels import Atlas

FIRST_SIDE = 8
"""Texels per side of the map that a code is reshaped to; every layer doubles it (RGCA supplement A)."""

TAPS = 4
"""Weights of a 4x4 kernel of stride 2 that reach one output texel, per input channel."""


class Upsampling(nn.Module):
    """A transposed 4x4 convolution of stride 2 with untied bias.

    Weight-normalised per output channel.

    Args:
        inputs, outputs: channels.
        side: texels per side of its output.
        is_last: no bias of its own, and weights of length zero: its output is zero until it has learned.
        has_bias: if not, it is linear.
        plain: a last layer is not weight-normalised: at length zero, a direction has no slope.
    """

    def __init__(
        self, inputs: int, outputs: int, side: int, is_last: bool = False, has_bias: bool = True, plain: bool = False
    ) -> None:
        super().__init__()
        conv = nn.ConvTranspose2d(inputs, outputs, 4, stride=2, padding=1, bias=False)
        nn.init.normal_(conv.weight, std=GAIN / math.sqrt(TAPS * inputs))
        self.conv = conv if is_last and plain else weight_norm(conv, dim=1)
        self.bias = None if is_last or not has_bias else nn.Parameter(torch.zeros(outputs, side, side))
        if is_last:
            nn.init.zeros_(conv.weight if plain else self.conv.parametrizations.weight.original0)

    def forward(self, features: Float[Tensor, "n inputs h w"]) -> Float[Tensor, "n outputs 2*h 2*w"]:
        """Twice the side."""
        out = self.conv(features)
        return out if self.bias is None else out + self.bias


def bilinear(atlas: Atlas, side: int) -> tuple[Int64[np.ndarray, "texels 4"], Float32[np.ndarray, "texels 4"]]:
    """The four texels of a coarser map around each texel of an atlas, and their shares.

    The map is of `side` squared, its texels row by row.
    """
    return bilinear_at((atlas.texel + 0.5) / atlas.size, side)


def bilinear_at(
    places: Float[np.ndarray, "n 2"], side: int
) -> tuple[Int64[np.ndarray, "n 4"], Float32[np.ndarray, "n 4"]]:
    """The four texels of a map around each place (down, across, both in 0..1), and their shares."""
    place = (places * side - 0.5).clip(0, side - 1)
    low = np.floor(place).astype(np.int64)
    high, share = np.minimum(low + 1, side - 1), (place - low).astype(np.float32)
    rows, columns = (np.stack([low[:, axis], high[:, axis]], 1) for axis in (0, 1))
    down, across = (np.stack([1 - share[:, axis], share[:, axis]], 1) for axis in (0, 1))
    nearest = rows[:, :, None] * side + columns[:, None]
    return nearest.reshape(-1, 4), (down[:, :, None] * across[:, None]).reshape(-1, 4)


class AtlasDecoder(nn.Module):
    """A code to values per texel.

    A linear layer to 8 x 8, then layers that double it, then bilinear to the atlas.

    Args:
        code: numbers of the code.
        channels: of the map that each layer reads; its number is that of the layers.
        outputs: values per texel.
        starts_at_zero: the last layer is an output, not features.
        beside: channels of maps that come beside the code's.
        plain: see `Upsampling`.
    """

    def __init__(
        self, atlas: Atlas, code: int, channels: Sequence[int], outputs: int, starts_at_zero: bool, beside: int = 0,
        plain: bool = False,
    ) -> None:  # fmt: skip
        super().__init__()
        self.start = linear(code, channels[0] * FIRST_SIDE**2)
        self.layers = nn.ModuleList()
        for layer, (inputs, passed) in enumerate(pairwise([channels[0] + beside, *channels[1:], outputs]), 1):
            is_last = starts_at_zero and layer == len(channels)
            self.layers.append(Upsampling(inputs, passed, FIRST_SIDE * 2**layer, is_last, plain=plain))
        nearest, weights = bilinear(atlas, FIRST_SIDE * 2 ** len(channels))
        self.register_buffer("nearest", torch.as_tensor(nearest), persistent=False)
        self.register_buffer("weights", torch.as_tensor(weights), persistent=False)

    def forward(
        self, code: Float[Tensor, " code"], beside: Float[Tensor, "beside 8 8"] | None = None
    ) -> Float[Tensor, "texels outputs"]:
        """Values of every valid texel."""
        features = self.start(code).reshape(1, -1, FIRST_SIDE, FIRST_SIDE)
        if beside is not None:
            features = torch.cat([features, beside[None]], 1)
        for layer in self.layers:
            features = layer(leaky_relu(features, SLOPE))
        return draw(features[0], self.nearest, self.weights)


def draw(
    map_: Float[Tensor, "channels h w"], nearest: Int[Tensor, "texels 4"], weights: Float[Tensor, "texels 4"]
) -> Float[Tensor, "texels channels"]:
    """Values of a map at the texels that `bilinear` placed on it."""
    rows = map_.flatten(1).T.contiguous()
    # Sums of weighted rows; three times as fast as drawing the whole map at the atlas' size.
    return embedding_bag(nearest, rows, per_sample_weights=weights, mode="sum")


class Additions:
    """Decoded values of texels as additions to their parameters.

    Args:
        parameters: the texels' own, by name, [texels, ...].
        units: what a value of 1 adds, where that is not 1.
        bounds: most that is added to a parameter, approached smoothly, where there is such a bound.
    """

    def __init__(
        self, parameters: Mapping[str, Tensor], units: Mapping[str, float], bounds: Mapping[str, float]
    ) -> None:
        self.units, self.bounds = dict(units), dict(bounds)
        self.shapes = {name: tensor.shape[1:] for name, tensor in parameters.items()}
        self.widths = [math.prod(shape) for shape in self.shapes.values()]

    def split(self, values: Float[Tensor, "texels outputs"]) -> dict[str, Float[Tensor, " texels *_"]]:
        """Additions to each parameter."""
        added = {
            name: self.units.get(name, 1.0) * part.reshape(-1, *shape)
            for (name, shape), part in zip(self.shapes.items(), values.split(self.widths, -1), strict=True)
        }
        return added | {name: bound * torch.tanh(added[name] / bound) for name, bound in self.bounds.items()}


class PoseDecoder(nn.Module):
    """D_ci of RFGCA 4 and RGCA 3, 9: additions of a pose or an expression to all parameters.

    Args:
        atlas: the texels.
        code: numbers of the code.
        channels: see `AtlasDecoder`.
        parameters, units, bounds: see `Additions`.
        beside: channels of maps that come beside the code's.
        plain: see `Upsampling`.
    """

    def __init__(
        self, atlas: Atlas, code: int, channels: Sequence[int], parameters: Mapping[str, Tensor],
        units: Mapping[str, float], bounds: Mapping[str, float] = MappingProxyType({}), beside: int = 0,
        plain: bool = False,
    ) -> None:  # fmt: skip
        super().__init__()
        self.additions = Additions(parameters, units, bounds)
        outputs = sum(self.additions.widths)
        self.decoder = AtlasDecoder(atlas, code, channels, outputs, starts_at_zero=True, beside=beside, plain=plain)

    def forward(
        self, code: Float[Tensor, " code"], beside: Float[Tensor, "beside 8 8"] | None = None
    ) -> dict[str, Float[Tensor, " texels *_"]]:
        """Additions to each parameter."""
        return self.additions.split(self.decoder(code, beside))


class ViewDecoder(nn.Module):
    """D_cv of RFGCA 14: additions of pose and view to logits of the specular visibility.

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
        """Features that all cameras of a frame share."""
        return self.decoder(code)

    def forward(
        self, shared: Float[Tensor, "texels width"], directions: Float[Tensor, "texels 3"]
    ) -> Float[Tensor, " texels"]:
        """Of one camera: unit directions to it, in the frame of each Gaussian."""
        features = torch.cat([leaky_relu(shared, SLOPE), directions], -1)
        return self.last(leaky_relu(self.hidden(features), SLOPE))[:, 0]
