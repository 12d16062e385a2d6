"""Parameters of texels that are optimised directly. One flat set of names, to which the parts of an avatar add."""

from __future__ import annotations

from dataclasses import fields

import torch
from jaxtyping import Float
from torch import Tensor, nn

from pipeline.avatar.texels.length_unit import length_unit_m
from pipeline.avatar.texels.texel_parameters import TexelParameters
from pipeline.geometry.texels import Atlas, adjoining_texels, texels_side_by_side


class TexelStore(nn.Module):
    """Module whose parts add parameters to it and read them by attribute, `store.albedo`.

    Parts keep a reference to the store instead of parameters of their own, so that what avatar.safetensors names does
    not depend on which part asked for it.

    Args:
        atlas: the texels.
        spacing: size of each texel on the rest surface along tangent and bitangent, metres.
    """

    def __init__(self, atlas: Atlas, spacing: Float[Tensor, "texels 2"]) -> None:
        super().__init__()
        self.atlas, self.unit_m = atlas, length_unit_m(atlas)
        self.register_buffer("spacing", spacing)
        adjoining = adjoining_texels(atlas)
        self.register_buffer("adjoining", torch.as_tensor(adjoining), persistent=False)
        self.register_buffer("pairs", torch.as_tensor(texels_side_by_side(adjoining)), persistent=False)

    def add(self, name: str, start: Float[Tensor, " texels *_"]) -> None:
        """Add a parameter that starts at `start`."""
        setattr(self, name, nn.Parameter(start))

    def fill(self, start: float, *shape: int) -> Tensor:
        """A start value that all texels share [texels, *shape]."""
        return torch.full((len(self.spacing), *shape), start)

    def shared(self) -> TexelParameters:
        """Parameters that networks may add to, as all frames share them."""
        names = (field.name for field in fields(TexelParameters))
        return TexelParameters(**{name: self.get_parameter(name) for name in names if hasattr(self, name)})
