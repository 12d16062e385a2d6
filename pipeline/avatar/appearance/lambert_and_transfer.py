"""Lambert under the lights that a texel sees, and learned transfer of what that leaves over."""

from __future__ import annotations

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.avatar.appearance.lambert import Lambert
from pipeline.avatar.appearance.transfer import start_transfer
from pipeline.avatar.appearance.zonal_transfer import ZonalTransfer
from pipeline.avatar.frames.light_fields import IncidentLight
from pipeline.avatar.frames.prepared import Surface
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.texel_parameters import TexelParameters
from pipeline.avatar.texels.texel_store import TexelStore


class LambertAndTransfer(ZonalTransfer):
    """Light in closed form plus zonal transfer that starts at nothing and is held there.

    The transfer sees all lights, hidden ones too: what goes through a limb comes from behind it, and where light below
    the surface takes the place of light on it, the transfer is negative.
    """

    works_under_sky = False

    def __init__(self, store: TexelStore, spec: AvatarSpec) -> None:
        super().__init__(store, spec)
        self.lambert = Lambert(store, spec)

    def start(self, spec: AvatarSpec) -> tuple[Tensor, Tensor]:
        """Nothing, for all texels."""
        color, mono = start_transfer(spec.degrees)
        return torch.zeros_like(color), torch.zeros_like(mono)

    def penalties(self, parameters: TexelParameters) -> dict[str, Tensor]:
        """Mean squared coefficients, of a weight of their own."""
        return {"leftover": super().penalties(parameters)["transfer"]}

    def shade(
        self, parameters: TexelParameters, surface: Surface, incident: IncidentLight
    ) -> Float[Tensor, "texels 3"]:
        """Sum of both."""
        unhidden = replace(incident, lights=replace(incident.lights, visibility_bits=None))
        analytic = self.lambert.shade(parameters, surface, incident)
        return analytic + super().shade(parameters, surface, unhidden)

    def passes(self, surface: Surface, center: Float[Tensor, "3"]) -> Float[Tensor, "texels 1"] | None:
        """Share that the coat lets out."""
        return self.lambert.passes(surface, center)
