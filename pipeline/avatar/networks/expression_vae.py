"""The conditional variational auto-encoder of RGCA 3, 4.

A head's vertices and mean texture to a latent code, and back.

    mu, sigma = E(V, T)        z = mu + sigma e        V' = D_v(z)

V is in the head's frame. By default both ends start at the principal components of the vertices that training sees: a
code's first numbers are their coordinates, and networks learn what is beyond. A dozen filmed expressions do not teach a
network what their plain averages say. With `code_start: random` they start as networks do.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float, Float32, Int64
from torch import Tensor, nn
from torch.nn.functional import embedding_bag, leaky_relu
from torch.nn.utils.parametrizations import weight_norm

from pipeline.avatar.frames.prepared import LARGEST_LOG_VARIANCE, Latent
from pipeline.avatar.networks.decoders import FIRST_SIDE
from pipeline.avatar.networks.pose_encoder import GAIN, SLOPE, linear
from pipeline.avatar.networks.pose_points import body_points
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.geometry.texels import Atlas

START_LOG_VARIANCE = -8.0
"""Codes start nearly certain, 0.02 of the spread that a standard normal has: more would shake the anchors before they
have learned anything; what divergence costs undoes it."""


def standard_divergence(latent: Latent) -> Float[Tensor, ""]:
    """KL divergence from a standard normal, mean over the code's numbers.

    KL(N(mu, sigma^2) || N(0, 1)) = (mu^2 + sigma^2 - log sigma^2 - 1) / 2.

    Above `LARGEST_LOG_VARIANCE`, sigma^2 goes on along its tangent: a variance that ran away comes back by a finite
    slope instead of overflowing. As sigma goes to 0 the divergence grows as -log sigma, without end, as it should.
    """
    low = latent.log_variance.clamp_max(LARGEST_LOG_VARIANCE)
    beyond = latent.log_variance - low
    excess = low.expm1() + beyond * low.exp()
    return 0.5 * (latent.mean.square() + excess - latent.log_variance).mean()


class Expression(nn.Module):
    """Encoder and vertex decoder.

    Args:
        atlas: the texels of mean textures; its template at rest.
        spec: sizes; textures are encoded through the decoders' layers backwards.
    """

    def __init__(self, atlas: Atlas, spec: AvatarSpec) -> None:
        super().__init__()
        vertices, code = len(atlas.rest_vertices), spec.code_size
        self.register_buffer("middle", torch.as_tensor(atlas.rest_vertices.astype(np.float32)))
        self.register_buffer("scale", torch.tensor(1.0))
        self.register_buffer("components", torch.zeros(code, 3 * vertices))
        self.register_buffer("texture_middle", torch.zeros(atlas.texel_count, 3))
        self.register_buffer("texture_scale", torch.tensor(1.0))
        self.register_buffer("chosen", torch.as_tensor(body_points(atlas, spec.pose_points)), persistent=False)
        self.points = linear(3 * len(self.chosen), code)
        self.texture = TextureEncoder(atlas, spec.decoder_channels[::-1], code)
        self.mean, self.log_variance = linear(2 * code, code), linear(2 * code, code)
        self.hidden, self.last = linear(code, 2 * code), linear(2 * code, 3 * vertices)
        self.start = spec.code_start
        # A mean and vertices that are zero at once would teach each other nothing.
        zero = (self.mean, self.log_variance, self.last) if self.start == "components" else (self.log_variance,)
        for layer in zero:
            nn.init.zeros_(layer.parametrizations.weight.original0)
        nn.init.constant_(self.log_variance.bias, START_LOG_VARIANCE)

    @torch.no_grad()
    def learn_statistics(
        self, vertices: Sequence[Float32[Tensor, "vertices 3"]], textures: Sequence[Float32[np.ndarray, "texels 3"]]
    ) -> None:
        """Take down what training sees.

        Mean and principal components of vertices, mean and deviation of textures.

        Args:
            vertices: of each frame, in the head's frame, metres.
            textures: linear RGB; none if the frames have none.
        """
        shapes = torch.stack(list(vertices)).double()
        self.middle.copy_(shapes.mean(0))
        away = (shapes - shapes.mean(0)).flatten(1)
        self.scale.copy_((away.square().sum(1).mean() / away.shape[1]).sqrt().clamp_min(SMALLEST_SCALE_M))
        if self.start == "components":
            spread, directions = torch.linalg.svd(away, full_matrices=False)[1:]
            used = min(len(self.components), int((spread > SMALLEST_SPREAD * spread[0]).sum()))
            self.components[:used] = directions[:used] * away.shape[1] ** 0.5
        if textures:
            colors = torch.as_tensor(np.stack(list(textures)))
            self.texture_middle.copy_(colors.mean(0))
            self.texture_scale.copy_((colors - colors.mean(0)).std().clamp_min(SMALLEST_COLOR))

    def encode(self, vertices: Float[Tensor, "vertices 3"], texture: Float[Tensor, "texels 3"] | None = None) -> Latent:
        """Codes that these vertices and this mean texture may have come from.

        Vertices are in the head's frame, metres.

        Without a texture, that of an average frame is taken.
        """
        away = (vertices - self.middle) / self.scale
        start = self.components @ away.flatten() / away.numel()
        colors = torch.zeros_like(self.texture_middle)
        if texture is not None:
            colors = (texture - self.texture_middle) / self.texture_scale
        seen = torch.cat([self.points(away[self.chosen].flatten()), self.texture(colors)])
        features = leaky_relu(seen, SLOPE)
        return Latent(start + self.mean(features), self.log_variance(features))

    def vertices(self, code: Float[Tensor, " code"]) -> Float[Tensor, "vertices 3"]:
        """V' = D_v(z), metres in the head's frame."""
        features = leaky_relu(self.hidden(code), SLOPE)
        away = code @ self.components + self.last(features)
        return self.middle + self.scale * away.reshape(-1, 3)


SMALLEST_SCALE_M = 1e-6
"""Vertices that move less than a micrometre do not move: what is divided by their spread stays finite."""

SMALLEST_SPREAD = 1e-4
"""Components below this share of the first are rounding, not expression."""

SMALLEST_COLOR = 1e-4
"""Textures that differ by less are equal."""


class TextureEncoder(nn.Module):
    """Encoder of a mean texture to features.

    It is averaged to a coarse map; then come 4x4 convolutions that halve it, to 8 x 8, and a linear layer. The layers
    of the decoders backwards (RGCA supplement A).
    """

    def __init__(self, atlas: Atlas, channels: Sequence[int], outputs: int) -> None:
        super().__init__()
        self.side = FIRST_SIDE * 2 ** len(channels)
        texels, bags = coarse_bags(atlas, self.side)
        self.register_buffer("texels", torch.as_tensor(texels), persistent=False)
        self.register_buffer("bags", torch.as_tensor(bags), persistent=False)
        self.layers = nn.ModuleList()
        for inputs, passed in zip((3, *channels[:-1]), channels, strict=True):
            conv = nn.Conv2d(inputs, passed, 4, stride=2, padding=1)
            nn.init.normal_(conv.weight, std=GAIN / (4 * inputs**0.5))
            nn.init.zeros_(conv.bias)
            self.layers.append(weight_norm(conv))
        self.last = linear(channels[-1] * FIRST_SIDE**2, outputs)

    def forward(self, texture: Float[Tensor, "texels 3"]) -> Float[Tensor, " outputs"]:
        """Features of a texture of mean 0 and deviation 1."""
        coarse = embedding_bag(self.texels, texture, self.bags, mode="mean")  # 0 where no texel falls
        features = coarse.T.reshape(1, 3, self.side, self.side)
        for layer in self.layers:
            features = leaky_relu(layer(features), SLOPE)
        return self.last(features.flatten())


def coarse_bags(atlas: Atlas, side: int) -> tuple[Int64[np.ndarray, " texels"], Int64[np.ndarray, " squares"]]:
    """Texels in the order of the squares of a coarser map, and where each square's begin."""
    row, column = (atlas.texel * side // atlas.size).astype(np.int64).T
    square = row * side + column
    order = np.argsort(square, kind="stable")
    return order, np.searchsorted(square[order], np.arange(side * side))
