"""Layers that are blended for one camera, as values of texels and then as images."""

from __future__ import annotations

from dataclasses import dataclass, fields
from itertools import accumulate

import torch
from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True)
class Layers:
    """Values of texels [texels, n] or images [h, w, n].

    None: this camera's picture has no such layer.

    Attributes:
        color: linear RGB without what the other layers add.
        normal, roughness, visibility: of a lobe that is evaluated per pixel.
        shadow: the factor that dims all but indirect light.
        indirect: linear RGB.
        mirrors: of eyes: visibility, and roughness as far as it is visible.
    """

    color: Float[Tensor, "*n 3"]
    normal: Float[Tensor, "*n 3"] | None = None
    roughness: Float[Tensor, "*n 1"] | None = None
    visibility: Float[Tensor, "*n 1"] | None = None
    shadow: Float[Tensor, "*n 1"] | None = None
    indirect: Float[Tensor, "*n 3"] | None = None
    mirrors: Float[Tensor, "*n 2"] | None = None

    def named(self) -> dict[str, Tensor]:
        """The layers that there are, in their order."""
        own = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: layer for name, layer in own.items() if layer is not None}

    def stacked(self) -> Float[Tensor, "*n channels"]:
        """All layers beside each other."""
        return torch.cat(list(self.named().values()), -1)

    def colors(self) -> tuple[int, ...]:
        """Channels of the stack at which what is linear RGB begins."""
        widths = {name: layer.shape[-1] for name, layer in self.named().items()}
        starts = dict(zip(widths, accumulate(widths.values(), initial=0), strict=False))
        return tuple(starts[name] for name in ("color", "indirect") if name in starts)

    def images(self, blended: Float[Tensor, "h w channels"]) -> Layers:
        """The same layers as images, from their stack once it is blended."""
        layers = self.named()
        parts = blended.split([layer.shape[-1] for layer in layers.values()], -1)
        return Layers(**dict(zip(layers, parts, strict=True)))
