"""Colour of a head by a network that is linear in the light (row "Linear" of RGCA)."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from pipeline.avatar.appearance.models import SpecularModel
from pipeline.avatar.frames.prepared import PreparedFrame, ViewedParameters


class LightLinear(SpecularModel):
    """Albedo times the network's colour, added to few harmonics."""

    works_under_sky = False

    def texel_light(
        self, frame: PreparedFrame, viewed: ViewedParameters, center: Float[Tensor, "3"]
    ) -> Float[Tensor, "texels 3"]:
        """Colour that the network gives this camera."""
        light = frame.incident.inputs.body_light
        return self.store.albedo * self.store.networks.linear_color(frame.decoded.head, center, light)
