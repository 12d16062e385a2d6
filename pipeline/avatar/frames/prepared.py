"""A frame as all its cameras share it. Placed and lit texels, and the state of head and eyes."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.avatar.frames.light_fields import IncidentLight
from pipeline.avatar.texels.posed_texels import PosedTexels
from pipeline.avatar.texels.texel_parameters import TexelParameters
from pipeline.lighting.lobes import mirror_direction, unit
from pipeline.lighting.visibility import Occluders
from pipeline.rendering.splat_types import Gaussians
from pipeline.rendering.volume_types import AnchoredVolumes

LARGEST_LOG_VARIANCE = 20.0
"""Standard deviations stay below 2e4, five orders above those of a standard normal, and finite in float32."""


@dataclass(frozen=True)
class Latent:
    """A normal distribution of codes."""

    mean: Float[Tensor, " code"]
    log_variance: Float[Tensor, " code"]

    def sample(self, noise: Float[Tensor, "*n code"]) -> Float[Tensor, "*n code"]:
        """mu + sigma e: the sample moves with mean and deviation (Kingma and Welling 2014)."""
        return self.mean + (0.5 * self.log_variance.clamp_max(LARGEST_LOG_VARIANCE)).exp() * noise


@dataclass(frozen=True)
class HeadState:
    """Expression and motion of a head.

    Attributes:
        code: z, the latent code.
        latent: the distribution it was drawn from; None where the code was given.
        decoded_vertices: V' = D_v(z), metres in the head's frame (RGCA 4).
        head_from_world: [R | t], metres.
        gaze: features of where the eyes look; None if no network is told.
    """

    code: Float[Tensor, " code"]
    latent: Latent | None
    decoded_vertices: Float[Tensor, "vertices 3"]
    head_from_world: Float[Tensor, "3 4"]
    gaze: Float[Tensor, "16 8 8"] | None = None


@dataclass(frozen=True)
class LidOcclusion:
    """Light and reflections that lids hide from the eyes of one frame.

    Attributes:
        opening: share of the outside that each eye texel sees, weighted by the cosine; 0 behind closed lids.
        skin: what hides it; None if the template has nothing but eyes.
    """

    opening: Float[Tensor, " eye_texels"]
    skin: Occluders | None

    @torch.no_grad()
    def pass_mirrored(
        self, points: Float[Tensor, "n 3"], normals: Float[Tensor, "n 3"], center: Float[Tensor, "3"]
    ) -> Float[Tensor, " n"]:
        """Let rays pass, 1, that are mirrored past the skin; 0 for those that are not.

        The rays come from `center`; points (metres) and unit normals are those of eyes.
        """
        if self.skin is None or not len(points):
            return torch.ones_like(points[:, 0])
        mirrored = mirror_direction(normals, unit(center - points))
        arrays = (tensor.double().cpu().numpy() for tensor in (points, normals, mirrored))
        return torch.as_tensor(self.skin.first_faces(*arrays)[0] < 0).to(points)


@dataclass(frozen=True)
class PosedEyes:
    """Explicit eyes of one frame.

    Attributes:
        turns: world from rest.
        centers, radii: of the spheres in the world, metres: all eyeballs, then all corneas.
        lids: what they hide.
        features: maps that the eyes' decoders read (RGCA 10); None without such.
        harmonics: light that comes to each eye texel past the lids, in the frame of its eye; None where it is lit with
            the rest.
    """

    turns: Float[Tensor, "eyes 3 3"]
    centers: Float[Tensor, "spheres 3"]
    radii: Float[Tensor, " spheres"]
    lids: LidOcclusion
    harmonics: Float[Tensor, "eye_texels 81 channels"] | None = None
    features: Float[Tensor, "eyes 23 4 4"] | None = None


@dataclass(frozen=True)
class Decoded:
    """Output of the networks for a frame, before any camera.

    Attributes:
        parameters: of the texels, in this pose.
        posed: the anchors.
        view_features: of texels, which the view decoder of a body goes on from.
        head: of a head.
    """

    parameters: TexelParameters
    posed: PosedTexels
    view_features: Float[Tensor, "texels width"] | None = None
    head: HeadState | None = None


@dataclass(frozen=True)
class ViewedParameters:
    """Output of the view decoder for one camera (RFGCA 14, RGCA 9); None: it does not say.

    Attributes:
        visibility: added to the logit of the specular visibility.
        normal_offset: added to that of the normal.
        specular_harmonics: harmonics of what is specular (row "EyeNeRF" of RGCA).
        eye_gain: factors on the albedo of eye texels (RGCA 10).
    """

    visibility: Float[Tensor, " texels"] | None = None
    normal_offset: Float[Tensor, "texels 3"] | None = None
    specular_harmonics: Float[Tensor, "texels 81"] | None = None
    eye_gain: Float[Tensor, "eye_texels 3"] | None = None


@dataclass(frozen=True)
class Surface:
    """Primitives of a frame, placed.

    Attributes:
        gaussians: as they are drawn; or boxes of voxels in their place.
        axes: R_k, rotation matrices of each texel's (RFGCA 6).
        posed: their anchors.
        bent_normals: unit normals for shading.
    """

    gaussians: Gaussians | AnchoredVolumes
    axes: Float[Tensor, "texels 3 3"]
    posed: PosedTexels
    bent_normals: Float[Tensor, "texels 3"]


@dataclass(frozen=True)
class Shading:
    """Light that leaves texels alike in all directions, linear RGB.

    Attributes:
        diffuse: of the lamps, before the learned shadow.
        shadow: factors of the shadow network; None: no such network.
        indirect: by way of other surfaces; None: left out.
    """

    diffuse: Float[Tensor, "texels 3"]
    shadow: Float[Tensor, " texels"] | None = None
    indirect: Float[Tensor, "texels 3"] | None = None


@dataclass(frozen=True)
class PreparedFrame:
    """Everything of a frame that no camera changes.

    Attributes:
        surface: placed primitives.
        decoded: what the networks say.
        incident: the light.
        shading: what it makes of texels.
        eyes: of an avatar with explicit eyes.
    """

    surface: Surface
    decoded: Decoded
    incident: IncidentLight
    shading: Shading
    eyes: PosedEyes | None = None

    @property
    def gaussians(self) -> Gaussians | AnchoredVolumes:
        """The Gaussians as they are drawn, or boxes in their place."""
        return self.surface.gaussians

    @property
    def parameters(self) -> TexelParameters:
        """Parameters of the texels in this frame."""
        return self.decoded.parameters

    @property
    def under_sky(self) -> bool:
        """Light comes from an environment map by harmonics and panoramas."""
        return self.incident.inputs.sky is not None
