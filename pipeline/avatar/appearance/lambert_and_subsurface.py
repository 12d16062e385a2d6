"""Lambert under the lights that a texel sees, and light that entered the surface elsewhere."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.avatar.appearance.lambert import Lambert
from pipeline.avatar.frames.light_fields import IncidentLight
from pipeline.avatar.frames.prepared import Surface
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.texel_parameters import TexelParameters
from pipeline.avatar.texels.texel_store import TexelStore
from pipeline.geometry.texel_regions import in_regions
from pipeline.lighting.subsurface import SubsurfaceSpread, surface_at_rest


class LambertAndSubsurface(Lambert):
    """Albedo over pi times the irradiance of a texel, and what spreads to it below the surface.

    All texels share the profile, fifteen numbers: the light of a few patterns tells it, and it holds for lights that
    were never lit.
    """

    def __init__(self, store: TexelStore, spec: AvatarSpec) -> None:
        super().__init__(store, spec)
        surface = surface_at_rest(store.atlas, store.spacing.double().numpy())
        where = np.flatnonzero(in_regions(store.atlas, spec.transport_regions)) if spec.transport_regions else None
        store.subsurface = SubsurfaceSpread(surface, where)

    def shade(
        self, parameters: TexelParameters, surface: Surface, incident: IncidentLight
    ) -> Float[Tensor, "texels 3"]:
        """Sum of both."""
        irradiance = self.irradiance(surface, incident)
        return self.store.albedo / torch.pi * (irradiance + self.store.subsurface(irradiance))
