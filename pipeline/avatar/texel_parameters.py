"""What every texel of an avatar has of its own: parameters that are optimised directly, and where they start."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from pipeline.avatar.body_networks import POSED
from pipeline.avatar.pose import rest_normals
from pipeline.avatar.shading import COLOR_DEGREES, start_harmonics, start_transfer
from pipeline.avatar.spec import AvatarSpec
from pipeline.avatar.traced_transfer import hidden_harmonics
from pipeline.geometry.texels import Atlas

START_ALBEDO = 0.4
START_OPACITY = 0.95
START_ROUGHNESS = 0.15
START_VISIBILITY = 0.02
START_GGX_WIDTH = 0.4
START_AMBIENT = 0.02
START_FILL = 0.6
"""A Gaussian's standard deviation along the surface, in texel spacings: neighbours' weights then sum to within 3 % of
a constant, so the start surface is closed and even."""

START_THICKNESS = 0.1
"""Standard deviation along the normal, in texel spacings: a thin disc."""


class TexelParameters(nn.Module):
    """One value per texel, of what `AvatarSpec` asks for.

    Args:
        atlas: the texels the Gaussians sit on.
        spacing: size of each texel on the rest surface along tangent and bitangent, metres [texels, 2].
    """

    def __init__(self, atlas: Atlas, spacing: Float[Tensor, "texels 2"], spec: AvatarSpec) -> None:
        super().__init__()
        self.spec = spec
        texels = len(spacing)
        thickness = START_THICKNESS * spacing.mean(-1, keepdim=True)
        self.offset = nn.Parameter(torch.zeros(texels, 3))
        self.rotation = nn.Parameter(torch.tensor([1.0, 0, 0, 0]).repeat(texels, 1))
        self.log_scale = nn.Parameter(torch.cat([START_FILL * spacing, thickness], -1).log())
        self.opacity = nn.Parameter(torch.full((texels,), START_OPACITY).logit())
        self.albedo = nn.Parameter(torch.full((texels, 3), START_ALBEDO))
        self.register_buffer("spacing", spacing)
        self.build_transfer(atlas, texels)
        if spec.bent_normals:
            self.normal_offset = nn.Parameter(torch.zeros(texels, 3))
        if spec.lobe:
            self.log_roughness = nn.Parameter(torch.full((texels,), START_ROUGHNESS).log())
            self.visibility = nn.Parameter(torch.full((texels,), START_VISIBILITY).logit())
        if spec.gloss:
            self.log_ggx_width = nn.Parameter(torch.full((texels,), START_GGX_WIDTH).log())
            self.log_gloss = nn.Parameter(torch.zeros(texels))

    def build_transfer(self, atlas: Atlas, texels: int) -> None:
        """Transfer coefficients, started at the Lambertian lobe of the normal; buffer `start_*` keeps where."""
        if self.spec.shading == "microfacet":
            return
        zonal = self.spec.shading == "transfer"
        for name, values in zip(("transfer_color", "transfer_mono"), self.start_transfer(atlas), strict=True):
            if not values.numel():
                continue
            self.register_buffer(f"start_{name}", values, persistent=zonal)  # what the atlas says is not stored twice
            repeats = (texels, *[1] * values.ndim) if zonal else [1] * values.ndim
            setattr(self, name, nn.Parameter(values.repeat(repeats)))

    def start_transfer(self, atlas: Atlas) -> tuple[Tensor, Tensor]:
        """Coloured and monochrome coefficients of a new avatar; of the latter there may be none."""
        degrees = self.spec.degrees
        if self.spec.shading == "transfer":
            return start_transfer(degrees)
        color, mono = start_harmonics(rest_normals(atlas), degrees)
        if self.spec.transfer_start == "traced":
            hidden = hidden_harmonics(atlas)[:, : degrees**2]
            color = color - hidden[:, : COLOR_DEGREES**2, None]
            mono = mono - hidden[:, COLOR_DEGREES**2 :]
        return color, mono

    def shared(self) -> dict[str, Tensor]:
        """The parameters that networks may add to, as all poses share them."""
        predicted = ("log_roughness",) if self.spec.head else ()  # RGCA 9; in RFGCA it is of the texel alone
        return {name: self.get_parameter(name) for name in (*POSED, *predicted) if hasattr(self, name)}
