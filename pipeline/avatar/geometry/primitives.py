"""Primitives on texels as the avatar knows them: what a new kind has to provide."""

from __future__ import annotations

from abc import ABC, abstractmethod

from jaxtyping import Float
from torch import Tensor

from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.posed_texels import PosedTexels
from pipeline.avatar.texels.texel_parameters import TexelParameters
from pipeline.avatar.texels.texel_store import TexelStore
from pipeline.rendering.splat_conventions import Splatted
from pipeline.rendering.splat_types import CameraView, Gaussians


class Primitives(ABC):
    """One primitive on each texel; it adds its parameters to the store."""

    @abstractmethod
    def __init__(self, store: TexelStore, spec: AvatarSpec) -> None: ...

    @abstractmethod
    def place(self, parameters: TexelParameters, posed: PosedTexels) -> tuple[Gaussians, Float[Tensor, "texels 3 3"]]:
        """Primitives in the world, and their rotation matrices."""

    @abstractmethod
    def draw(self, gaussians: Gaussians, features: Float[Tensor, "texels d"], camera: CameraView) -> Splatted:
        """Blend features of the primitives into one picture."""
