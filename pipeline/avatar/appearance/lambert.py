"""Lambert under the lights that a texel sees, bare or under a coat, in closed form."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from pipeline.avatar.appearance.models import DiffuseModel
from pipeline.avatar.frames.light_fields import IncidentLight
from pipeline.avatar.frames.prepared import Surface
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.texel_parameters import TexelParameters
from pipeline.avatar.texels.texel_store import TexelStore
from pipeline.lighting.lobes import unit
from pipeline.lighting.matte import arriving_vectors, coat_passes, grazing_irradiance

COAT_SHARES = (-1.0, 1.0)
"""Bounds: no more than all grazing light is kept back, and at most as much added, as on a rough matte surface."""


class Coat(nn.Module):
    """Share of grazing light that the subject's coat keeps back; it starts at nothing."""

    def __init__(self) -> None:
        super().__init__()
        self.share = nn.Parameter(torch.zeros(()))

    @property
    def bounded(self) -> Float[Tensor, ""]:
        """The share, within `COAT_SHARES`; beyond them its slope still leads back."""
        return self.share + (self.share.clamp(*COAT_SHARES) - self.share).detach()


class Lambert(DiffuseModel):
    """albedo / pi * sum I / d^2 max(0, n . w), of which a coat keeps back some as it comes and as it goes."""

    def __init__(self, store: TexelStore, spec: AvatarSpec) -> None:
        super().__init__(store, spec)
        if spec.coated:
            store.coat = Coat()

    @property
    def coat(self) -> Coat | None:
        """The coat; None: bare."""
        return getattr(self.store, "coat", None)

    def shade(
        self, parameters: TexelParameters, surface: Surface, incident: IncidentLight
    ) -> Float[Tensor, "texels 3"]:
        """Irradiance over pi, times albedo."""
        return self.store.albedo / torch.pi * self.irradiance(surface, incident)

    def irradiance(self, surface: Surface, incident: IncidentLight) -> Float[Tensor, "texels channels"]:
        """Irradiance by the lamps that a texel sees, less what its coat keeps back."""
        normals, points = surface.bent_normals, surface.gaussians.means.detach()
        irradiance = (arriving_vectors(points, normals, incident.lights) * normals[:, None]).sum(-1)
        if self.coat is not None:
            irradiance = irradiance - self.coat.bounded * grazing_irradiance(points, normals, incident.lights)
        return irradiance

    def passes(self, surface: Surface, center: Float[Tensor, "3"]) -> Float[Tensor, "texels 1"] | None:
        """Share that the coat lets out; at texels that face away, that of grazing light."""
        if self.coat is None:
            return None
        toward = unit(center - surface.gaussians.means.detach())
        cosine = (surface.bent_normals * toward).sum(-1, keepdim=True).clamp(0, 1)
        return coat_passes(cosine, self.coat.bounded)
