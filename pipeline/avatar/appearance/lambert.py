"""Lambert under the lights that a texel sees: matte surfaces in closed form."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.avatar.appearance.models import DiffuseModel
from pipeline.avatar.frames.light_fields import IncidentLight
from pipeline.avatar.frames.prepared import Surface
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.texel_parameters import TexelParameters
from pipeline.avatar.texels.texel_store import TexelStore
from pipeline.lighting.microfacet import arriving_vectors


class Lambert(DiffuseModel):
    """albedo / pi * sum I / d^2 max(0, n . w)."""

    def __init__(self, store: TexelStore, spec: AvatarSpec) -> None:
        self.store = store

    def shade(
        self, parameters: TexelParameters, surface: Surface, incident: IncidentLight
    ) -> Float[Tensor, "texels 3"]:
        """Irradiance over pi, times albedo."""
        normals = surface.bent_normals
        vectors = arriving_vectors(surface.gaussians.means.detach(), normals, incident.lights)
        return self.store.albedo / torch.pi * (vectors * normals[:, None]).sum(-1)
