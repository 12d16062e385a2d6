"""Specular harmonics that a network gives each camera (row "EyeNeRF" of RGCA)."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from pipeline.avatar.appearance.models import SpecularModel
from pipeline.avatar.frames.prepared import PreparedFrame, ViewedParameters


class ViewedHarmonics(SpecularModel):
    """Harmonics in the frame of the light. May be negative, as a band-limited highlight is beside its peak."""

    works_under_sky = False

    def texel_light(
        self, frame: PreparedFrame, viewed: ViewedParameters, center: Float[Tensor, "3"]
    ) -> Float[Tensor, "texels channels"]:
        """Product of the camera's harmonics with the light."""
        return (viewed.specular_harmonics[..., None] * frame.incident.harmonics).sum(1)


class TangentHarmonics(SpecularModel):
    """The same in the frame of each texel's tangents, where a network sees the camera, too."""

    works_under_sky = False

    def texel_light(
        self, frame: PreparedFrame, viewed: ViewedParameters, center: Float[Tensor, "3"]
    ) -> Float[Tensor, "texels channels"]:
        """Product of the texels' harmonics with the light."""
        inputs = frame.incident.inputs
        harmonics = self.store.networks.texels(frame.decoded.head.code, inputs.posed, center)
        return (harmonics[..., None] * inputs.tangent_harmonics).sum(1)
