"""Gloss of a dielectric with GGX microfacets, at every texel."""

from __future__ import annotations

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from pipeline.avatar.appearance.glossy import GlossySamples
from pipeline.avatar.appearance.models import SpecularModel
from pipeline.avatar.appearance.penalties import GGX_WIDTH_BOUNDS
from pipeline.avatar.frames.prepared import PreparedFrame, ViewedParameters
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.texel_parameters import TexelParameters
from pipeline.avatar.texels.texel_store import TexelStore
from pipeline.geometry.texel_regions import in_regions
from pipeline.lighting.lobe_kernels import LOBE_CONSTANT
from pipeline.lighting.lobes import unit
from pipeline.lighting.microfacet import gather_reflections
from pipeline.lighting.reflection_kernels import DIELECTRIC_F0


class GgxGloss(SpecularModel):
    """Cook-Torrance reflection, scaled per texel; each highlight is shadowed by itself.

    The store's buffer `glossy` has the texels of the regions that have gloss; without it all have.
    """

    works_under_sky = False

    def __init__(self, store: TexelStore, spec: AvatarSpec) -> None:
        super().__init__(store, spec)
        if spec.gloss_regions:
            glossy = torch.as_tensor(in_regions(store.atlas, spec.gloss_regions))
            store.register_buffer("glossy", glossy, persistent=False)
        store.add("log_ggx_width", store.fill(spec.start_ggx_width).log())
        store.add("log_gloss", store.fill(0.0))

    @property
    def glossy(self) -> Bool[Tensor, " texels"] | None:
        """Texels that have gloss; None: all."""
        return getattr(self.store, "glossy", None)

    def scale(self) -> Float[Tensor, " texels"]:
        """Factor on what a dielectric reflects; 0 where there is no gloss."""
        gloss = self.store.log_gloss.exp()
        return gloss if self.glossy is None else gloss * self.glossy

    def texel_light(
        self, frame: PreparedFrame, viewed: ViewedParameters, center: Float[Tensor, "3"]
    ) -> Float[Tensor, "texels channels"]:
        """Reflection towards the camera."""
        width, points = self.store.log_ggx_width.exp(), frame.gaussians.means.detach()
        toward, lights = unit(center - points), frame.incident.lights
        normals = frame.surface.bent_normals
        if self.glossy is not None:  # from behind, a point reflects nothing, in next to no time
            toward = torch.where(self.glossy[:, None], toward, -normals.detach())
        reflected = gather_reflections(points, normals, toward, width, lights)
        return self.scale()[:, None] * reflected

    def mirrors(self, frame: PreparedFrame, viewed: ViewedParameters) -> GlossySamples:
        """Texels as lobes about the mirror direction.

        A half vector of GGX has slopes of variance a^2 / 2, and the mirrored direction turns twice as far: sigma^2 = 2
        a^2. The lobe's height makes its integral over directions what a dielectric mirrors at normal incidence, F0
        times the gloss: v C / sigma 2 pi sigma^2 = g F0.
        """
        sigma = math.sqrt(2) * self.store.log_ggx_width.exp()
        visibility = self.scale() * DIELECTRIC_F0 / (2 * math.pi * LOBE_CONSTANT * sigma)
        return GlossySamples(frame.gaussians.means.detach(), frame.surface.bent_normals, sigma, visibility)

    def penalties(self, parameters: TexelParameters) -> dict[str, Float[Tensor, ""]]:
        """Squared logarithms of the scale."""
        return {"gloss": self.store.log_gloss.square().mean()}

    def bounded(self, parameters: TexelParameters) -> tuple[Float[Tensor, " texels"], float, float]:
        """Widths and their bounds."""
        return self.store.log_ggx_width.exp(), *GGX_WIDTH_BOUNDS
