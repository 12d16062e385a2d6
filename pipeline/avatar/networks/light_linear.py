"""A decoder of colours that is linear in the light.

The row "Linear" of RGCA (after Yang et al. 2023).

Two branches of the same layers. One, with biases and leaky ReLUs, decodes features of expression and view; the other
starts from the light, has neither, and is multiplied by the first one's features before each layer: whatever the
features are, twice the light is twice the colour, and a sum of lights the sum of their colours.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import leaky_relu

from pipeline.avatar.networks.decoders import FIRST_SIDE, Upsampling, bilinear, draw
from pipeline.avatar.networks.pose_encoder import SLOPE, linear
from pipeline.geometry.texels import Atlas
from pipeline.lighting.environment_sh import COEFFICIENTS

COLORS = 3


class LightLinearDecoder(nn.Module):
    """A code, a view and a light to a colour per texel.

    Args:
        code, channels, beside, plain: as of `AtlasDecoder`.
    """

    def __init__(self, atlas: Atlas, code: int, channels: Sequence[int], beside: int, plain: bool = False) -> None:
        super().__init__()
        self.start = linear(code, channels[0] * FIRST_SIDE**2)
        self.light = nn.Linear(COEFFICIENTS, (channels[0] + beside) * FIRST_SIDE**2, bias=False)
        nn.init.normal_(self.light.weight, std=1 / math.sqrt(COEFFICIENTS))
        self.features, self.carried = nn.ModuleList(), nn.ModuleList()
        widths = [channels[0] + beside, *channels[1:], COLORS]
        for layer, (inputs, passed) in enumerate(pairwise(widths), 1):
            is_last, side = layer == len(channels), FIRST_SIDE * 2**layer
            if not is_last:
                self.features.append(Upsampling(inputs, passed, side))
            self.carried.append(Upsampling(inputs, passed, side, is_last=is_last, has_bias=False, plain=plain))
        nearest, weights = bilinear(atlas, FIRST_SIDE * 2 ** len(channels))
        self.register_buffer("nearest", torch.as_tensor(nearest), persistent=False)
        self.register_buffer("weights", torch.as_tensor(weights), persistent=False)

    def forward(
        self, code: Float[Tensor, " code"], beside: Float[Tensor, "beside 8 8"], light: Float[Tensor, "81 channels"]
    ) -> Float[Tensor, "texels 3"]:
        """Colours without albedo, linear RGB.

        Args:
            light: L_lm in the head's frame; one channel for white light.
        """
        features = torch.cat([self.start(code).reshape(1, -1, FIRST_SIDE, FIRST_SIDE), beside[None]], 1)
        carried = self.light(light.T).reshape(light.shape[1], -1, FIRST_SIDE, FIRST_SIDE)
        for layer, carry in enumerate(self.carried):
            features = leaky_relu(features, SLOPE)
            carried = carry(carried * features)
            if layer < len(self.features):
                features = self.features[layer](features)
        # Each colour of a texel is fed by its own colour of the light.
        own = carried[0] if len(carried) == 1 else torch.stack([carried[c, c] for c in range(COLORS)])
        return draw(own, self.nearest, self.weights)
