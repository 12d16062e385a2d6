"""Primitives on texels as the avatar knows them: what a new kind has to provide."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection

from jaxtyping import Float
from torch import Tensor

from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.posed_texels import PosedTexels
from pipeline.avatar.texels.texel_parameters import TexelParameters
from pipeline.avatar.texels.texel_store import TexelStore
from pipeline.geometry.texels import Atlas
from pipeline.rendering.splat_conventions import Splatted
from pipeline.rendering.splat_types import CameraView, Gaussians
from pipeline.rendering.volume_types import AnchoredVolumes


class Primitives(ABC):
    """Primitives on texels; they add their parameters to the store.

    Attributes:
        network_atlas: the texels that primitives stand on, where these are not all of the store's: offset, rotation and
            scale have a row for each of them, and are decoded there.
    """

    network_atlas: Atlas | None = None

    @abstractmethod
    def __init__(self, store: TexelStore, spec: AvatarSpec) -> None: ...

    @abstractmethod
    def place(
        self, parameters: TexelParameters, posed: PosedTexels
    ) -> tuple[Gaussians | AnchoredVolumes, Float[Tensor, "texels 3 3"]]:
        """Primitives in the world, and the rotation matrix of each texel's."""

    @abstractmethod
    def draw(
        self, primitives: Gaussians | AnchoredVolumes, features: Float[Tensor, "texels d"], camera: CameraView,
        colors: Collection[int] = (0,),
    ) -> Splatted:  # fmt: skip
        """Blend features of texels into one picture.

        Args:
            colors: the first channels of what is linear RGB among the features.
        """
