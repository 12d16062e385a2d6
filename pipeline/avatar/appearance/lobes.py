"""Specular lobes of the papers, evaluated per pixel (RFGCA 11-12) or at every texel."""

from __future__ import annotations

from abc import abstractmethod

import torch
from jaxtyping import Float, Int
from torch import Tensor

from pipeline.avatar.appearance.glossy import GlossySamples, shade_halfway, shade_specular
from pipeline.avatar.appearance.layers import Layers
from pipeline.avatar.appearance.models import SpecularModel
from pipeline.avatar.appearance.penalties import HALFWAY_BOUNDS, ROUGHNESS_BOUNDS
from pipeline.avatar.frames.prepared import PreparedFrame, ViewedParameters
from pipeline.avatar.geometry.pixel_depth import depth_of_pixels, points_of_pixels
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.texel_parameters import TexelParameters
from pipeline.avatar.texels.texel_store import TexelStore
from pipeline.lighting.lobes import cosine_gaussian
from pipeline.rendering.splat_conventions import Splatted
from pipeline.rendering.splat_types import CameraView

START_ROUGHNESS = 0.15
START_VISIBILITY = 0.02

SMALLEST_ALPHA = 1 / 255
"""Pixels with less coverage hold nothing to shade; the rasteriser's own cut-off."""


SMALLEST_ROUGHNESS = 1e-3
"""Least roughness of a pixel that is hardly covered, where that is not divided by alpha, radians: a tenth of the least
that Gaussians have, and wide enough for the six sigmas of a lobe to be told apart by cosines in float32."""


class SpecularLobe(SpecularModel):
    """A lobe with a roughness and a visibility per texel.

    Attributes:
        bounds: of the roughness, radians.
        deferred: evaluated per pixel.
    """

    bounds = ROUGHNESS_BOUNDS
    works_under_sky = True  # panoramas are prefiltered for lobes about mirror directions

    def __init__(self, store: TexelStore, spec: AvatarSpec) -> None:
        super().__init__(store, spec)
        self.deferred, self.depth, self.screen_maps = spec.deferred, spec.depth, spec.screen_maps
        store.add("log_roughness", store.fill(START_ROUGHNESS).log())
        store.add("visibility", store.fill(START_VISIBILITY).logit())

    @abstractmethod
    def shade(self, samples: GlossySamples, frame: PreparedFrame, center: Tensor) -> Float[Tensor, "n channels"]:
        """Linear radiance of texels or pixels towards a camera at `center`."""

    def samples(self, frame: PreparedFrame, viewed: ViewedParameters) -> GlossySamples:
        """Texels with roughness and visibility as one camera sees them."""
        roughness = frame.parameters.log_roughness.exp()
        visibility = self.visibility(viewed)
        return GlossySamples(frame.gaussians.means.detach(), frame.surface.bent_normals, roughness, visibility)

    def visibility(self, viewed: ViewedParameters) -> Float[Tensor, " texels"]:
        """v_k as one camera sees it."""
        return torch.sigmoid(self.store.visibility + (0 if viewed.visibility is None else viewed.visibility))

    def shade_pixels(
        self, images: Layers, picture: Splatted, frame: PreparedFrame, camera: CameraView
    ) -> tuple[Int[Tensor, " n"], Int[Tensor, " n"], Float[Tensor, "n channels"]]:
        """Row and column of covered pixels, and the lobe evaluated once for each (RFGCA 11-12)."""
        alpha = picture.alpha
        row, column = torch.nonzero(alpha.detach() > SMALLEST_ALPHA, as_tuple=True)
        normal, roughness, visibility = (
            layer[row, column] for layer in (images.normal, images.roughness, images.visibility)
        )
        mesh = frame.incident.inputs.mesh if self.depth == "traced" else None
        depth = depth_of_pixels(self.depth, picture, mesh, camera)
        points = points_of_pixels(row, column, depth[row, column], camera)
        pixels = GlossySamples(points, normal, self.of_pixels(roughness[:, 0], alpha[row, column]), visibility[:, 0])
        return row, column, self.shade(pixels, frame, camera.center)

    def of_pixels(self, blended: Float[Tensor, " n"], alpha: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
        """Roughness of pixels, as `screen_maps` says."""
        if self.screen_maps == "accumulated":
            return blended.clamp_min(SMALLEST_ROUGHNESS)
        return blended / alpha.clamp_min(SMALLEST_ALPHA)

    def bounded(self, parameters: TexelParameters) -> tuple[Float[Tensor, " texels"], float, float]:
        """Roughness and its bounds."""
        return parameters.log_roughness.exp(), *self.bounds


class AngularLobe(SpecularLobe):
    """A spherical Gaussian of the angle to the mirror direction (RGCA 6, RFGCA 13)."""

    def shade(self, samples: GlossySamples, frame: PreparedFrame, center: Tensor) -> Float[Tensor, "n channels"]:
        """Lobe about the mirror direction."""
        return shade_specular(samples, center, frame.incident.lights, self.mirror_lobe, self.fresnel)


class CosineLobe(AngularLobe):
    """A spherical Gaussian of the cosine to the mirror direction (RGCA supplement C)."""

    mirror_lobe = staticmethod(cosine_gaussian)


class HalfVectorLobe(SpecularLobe):
    """A spherical Gaussian of twice the half vector's angle to the normal."""

    bounds = HALFWAY_BOUNDS
    works_under_sky = False

    def shade(self, samples: GlossySamples, frame: PreparedFrame, center: Tensor) -> Float[Tensor, "n channels"]:
        """Lobe about half vectors."""
        return shade_halfway(samples, center, frame.incident.lights)
