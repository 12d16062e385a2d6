"""Gloss of a dielectric with GGX microfacets, at every texel."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from pipeline.avatar.appearance.models import SpecularModel
from pipeline.avatar.appearance.penalties import GGX_WIDTH_BOUNDS, outside
from pipeline.avatar.frames.prepared import PreparedFrame, ViewedParameters
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.texel_parameters import TexelParameters
from pipeline.avatar.texels.texel_store import TexelStore
from pipeline.lighting.lobes import unit
from pipeline.lighting.microfacet import gather_reflections

START_GGX_WIDTH = 0.4


class GgxGloss(SpecularModel):
    """Cook-Torrance reflection, scaled per texel; each highlight is shadowed by itself."""

    works_under_sky = False

    def __init__(self, store: TexelStore, spec: AvatarSpec) -> None:
        super().__init__(store, spec)
        store.add("log_ggx_width", store.fill(START_GGX_WIDTH).log())
        store.add("log_gloss", store.fill(0.0))

    def texel_light(
        self, frame: PreparedFrame, viewed: ViewedParameters, center: Float[Tensor, "3"]
    ) -> Float[Tensor, "texels channels"]:
        """Reflection towards the camera."""
        width, points = self.store.log_ggx_width.exp(), frame.gaussians.means.detach()
        toward, lights = unit(center - points), frame.incident.lights
        reflected = gather_reflections(points, frame.surface.bent_normals, toward, width, lights)
        return self.store.log_gloss.exp()[:, None] * reflected

    def penalties(self, parameters: TexelParameters) -> dict[str, Float[Tensor, ""]]:
        """Widths outside of their bounds, and squared logarithms of the scale."""
        width = outside(self.store.log_ggx_width.exp(), *GGX_WIDTH_BOUNDS)
        return {"roughness": width, "gloss": self.store.log_gloss.square().mean()}
