"""Spherical harmonics that are not turned with the Gaussians (RGCA 5).

They are in the frame of the body or the head.
"""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from pipeline.avatar.appearance.traced_transfer import hidden_harmonics
from pipeline.avatar.appearance.transfer import COLOR_DEGREES, LearnedTransfer, shade_harmonics, start_harmonics
from pipeline.avatar.frames.light_fields import IncidentLight
from pipeline.avatar.frames.prepared import Surface
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.posed_texels import rest_normals
from pipeline.avatar.texels.texel_parameters import TexelParameters


class UnturnedHarmonics(LearnedTransfer):
    """Diffuse light by coefficients that start at the Lambertian lobe of the normal at rest."""

    reads_harmonics = works_under_sky = True

    def start(self, spec: AvatarSpec) -> tuple[Tensor, Tensor]:
        """Lambertian lobe of each normal at rest, less what the template hides if that is traced."""
        atlas = self.store.atlas
        color, mono = start_harmonics(rest_normals(atlas), spec.degrees)
        if spec.transfer_start == "traced":
            hidden = hidden_harmonics(atlas)[:, : spec.degrees**2]
            color = color - hidden[:, : COLOR_DEGREES**2, None]
            mono = mono - hidden[:, COLOR_DEGREES**2 :]
        return color, mono

    def shade(
        self, parameters: TexelParameters, surface: Surface, incident: IncidentLight
    ) -> Float[Tensor, "texels 3"]:
        """Product of the coefficients with the light."""
        light = incident.harmonics[:, : self.degrees**2]
        return shade_harmonics(self.store.albedo, parameters.transfer_color, parameters.transfer_mono, light)
