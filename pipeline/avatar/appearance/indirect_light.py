"""Light by way of other surfaces: a learned share of all light, or one traced bounce."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.avatar.appearance.models import IndirectModel
from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.frames.light_fields import IncidentLight
from pipeline.avatar.frames.prepared import Surface
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.texel_store import TexelStore
from pipeline.lighting.bounces import bounced_irradiance
from pipeline.lighting.distant import arriving_light

START_AMBIENT = 0.02


class AmbientLight(IndirectModel):
    """A learned share of all light that is sent to a texel, seen or not."""

    works_under_sky = False

    def __init__(self, store: TexelStore, spec: AvatarSpec) -> None:
        super().__init__(store, spec)
        store.add("ambient", store.fill(START_AMBIENT, 3))

    def shade(
        self, surface: Surface, incident: IncidentLight, diffuse: Tensor, shadow: Tensor | None
    ) -> Float[Tensor, "texels 3"]:
        """Share of the sum of I / d^2."""
        sent = arriving_light(surface.gaussians.means.detach(), incident.lights)
        return self.store.albedo * self.store.ambient / torch.pi * sent


class OneBounce(IndirectModel):
    """Light of the texels that traced rays hit."""

    def trace(self, inputs: FrameInputs) -> None:
        """Trace the texels that rays hit."""
        _ = inputs.bounces

    def shade(
        self, surface: Surface, incident: IncidentLight, diffuse: Tensor, shadow: Tensor | None
    ) -> Float[Tensor, "texels 3"]:
        """Sum over the texels that rays hit."""
        source = diffuse.detach().clamp_min(0)
        if shadow is not None:
            source = source * shadow.detach()[:, None]
        arriving = bounced_irradiance(source, incident.inputs.bounces, self.store.adjoining)
        return self.store.albedo / torch.pi * arriving
