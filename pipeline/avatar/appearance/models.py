"""Parts of an appearance as the avatar knows them: what a new one has to provide.

Each is built as `Part(store, spec)`: it adds the parameters that it needs to the store, and reads of the spec what
concerns itself. `pipeline.avatar.build` lists all parts by name.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from jaxtyping import Float, UInt8
from torch import Tensor

from pipeline.avatar.appearance.glossy import GlossySamples, shade_near_mirrors
from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.frames.light_fields import IncidentLight
from pipeline.avatar.frames.prepared import PreparedFrame, Surface, ViewedParameters
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.posed_texels import PosedTexels
from pipeline.avatar.texels.texel_parameters import TexelParameters
from pipeline.avatar.texels.texel_store import TexelStore
from pipeline.lighting.lobes import Lobe, angular_gaussian


class Part:
    """A part of an avatar's appearance.

    Attributes:
        works_under_sky: light may come by harmonics and panoramas of a map, not lamp by lamp.
    """

    works_under_sky = False

    def __init__(self, store: TexelStore, spec: AvatarSpec) -> None:
        self.store = store

    def bounded(self, parameters: TexelParameters) -> tuple[Float[Tensor, " texels"], float, float] | None:
        """Widths of a lobe with their bounds; None for what has none."""
        return None

    def penalties(self, parameters: TexelParameters) -> dict[str, Float[Tensor, ""]]:
        """Terms of the training loss, by the name of their weight in the settings, `weight_NAME`."""
        return {}


class DiffuseModel(Part, ABC):
    """Light that leaves texels alike in all directions, or nearly so.

    Attributes:
        reads_harmonics: it asks for the incident light in spherical harmonics.
    """

    reads_harmonics = False

    @abstractmethod
    def shade(
        self, parameters: TexelParameters, surface: Surface, incident: IncidentLight
    ) -> Float[Tensor, "texels 3"]:
        """Linear RGB of every texel under the lamps, before any learned shadow."""

    def passes(self, surface: Surface, center: Float[Tensor, "3"]) -> Float[Tensor, "texels 1"] | None:
        """Share of light that leaves texels for a camera at `center`; None: all.

        Of diffuse light, and of light by way of other surfaces.
        """
        return None


class NormalModel(Part, ABC):
    """Normals for shading."""

    @abstractmethod
    def bend(
        self, parameters: TexelParameters, axes: Tensor, posed: PosedTexels, added: Tensor | None = None
    ) -> Float[Tensor, "texels 3"]:
        """Unit normals.

        Args:
            axes: rotation matrices of the Gaussians.
            added: what a camera adds to the learned offset.
        """


class SpecularModel(Part):
    """Light that depends on the view. Evaluated at texels, or as samples of a lobe; this one has neither.

    Attributes:
        mirror_lobe: G about a mirror direction. Near mirrors, as eyes are, know no other angle.
        fresnel: how that grows towards grazing views.
    """

    works_under_sky = True
    mirror_lobe: Lobe = staticmethod(angular_gaussian)

    def __init__(self, store: TexelStore, spec: AvatarSpec) -> None:
        super().__init__(store, spec)
        self.fresnel = spec.fresnel

    def texel_light(
        self, frame: PreparedFrame, viewed: ViewedParameters, center: Float[Tensor, "3"]
    ) -> Float[Tensor, "texels channels"] | None:
        """Linear radiance of every texel towards a camera at `center`; None: nothing."""
        return None

    def samples(self, frame: PreparedFrame, viewed: ViewedParameters) -> GlossySamples | None:
        """Texels as samples of the lobe; None for what has no lobe."""
        return None

    def mirrors(self, frame: PreparedFrame, viewed: ViewedParameters) -> GlossySamples | None:
        """Texels as near mirrors, of which eyes are taken; None for what mirrors nothing."""
        return self.samples(frame, viewed)

    def reflect(self, mirrors: GlossySamples, frame: PreparedFrame, center: Tensor) -> Float[Tensor, "n channels"]:
        """Linear radiance of mirrors near each other, as eyes are; see `shade_near_mirrors`."""
        return shade_near_mirrors(mirrors, center, frame.incident.lights, self.mirror_lobe, self.fresnel)

    def under_sky(self) -> SpecularModel:
        """The same parameters under an environment map."""
        return self


class ShadowModel(Part):
    """Shadows of the lamps; this one has none."""

    works_under_sky = True

    def bits(self, inputs: FrameInputs) -> UInt8[np.ndarray, "lights bytes"] | None:
        """Texels that see each light, as `PointLights` has them; None: all of them do."""
        return None

    def factor(self, inputs: FrameInputs) -> Float[Tensor, " texels"] | None:
        """Share of the light that every texel keeps; None: all of it."""
        return None


class IndirectModel(Part):
    """Light by way of other surfaces; this one leaves it out."""

    works_under_sky = True

    def trace(self, inputs: FrameInputs) -> None:
        """Trace what `shade` needs of a pose; the inputs keep it."""

    def shade(
        self, surface: Surface, incident: IncidentLight, diffuse: Tensor, shadow: Tensor | None
    ) -> Float[Tensor, "texels 3"] | None:
        """Linear RGB of every texel. What surfaces send is taken as it is: no gradient goes back along a bounce."""
        return None
