"""Zonal transfer along the axes of each Gaussian, turned with it (RFGCA 7-9)."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from pipeline.avatar.appearance.transfer import LearnedTransfer, shade_diffuse, start_transfer
from pipeline.avatar.frames.light_fields import IncidentLight
from pipeline.avatar.frames.prepared import Surface
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.texel_parameters import TexelParameters


class ZonalTransfer(LearnedTransfer):
    """Diffuse light by learned zonal lobes; the same start for all texels."""

    starts_alike = works_under_sky = True

    def start(self, spec: AvatarSpec) -> tuple[Tensor, Tensor]:
        """Lambertian lobe along the normal."""
        return start_transfer(spec.degrees)

    def shade(
        self, parameters: TexelParameters, surface: Surface, incident: IncidentLight
    ) -> Float[Tensor, "texels 3"]:
        """Product of the lobes with the light along the Gaussians' axes."""
        light = incident.along_axes(surface.gaussians.means, surface.axes, self.degrees)
        return shade_diffuse(self.store.albedo, parameters.transfer_color, parameters.transfer_mono, light)
