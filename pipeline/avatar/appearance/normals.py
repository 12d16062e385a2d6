"""Normals for shading: of the mesh, or bent away from it as learned (RFGCA 10, RGCA 9)."""

from __future__ import annotations

from abc import abstractmethod

from jaxtyping import Float
from torch import Tensor

from pipeline.avatar.appearance.models import NormalModel
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.posed_texels import PosedTexels
from pipeline.avatar.texels.texel_parameters import TexelParameters
from pipeline.avatar.texels.texel_store import TexelStore
from pipeline.lighting.lobes import unit


class MeshNormals(NormalModel):
    """Normals of the posed mesh."""

    def bend(
        self, parameters: TexelParameters, axes: Tensor, posed: PosedTexels, added: Tensor | None = None
    ) -> Float[Tensor, "texels 3"]:
        """Normals as they are."""
        return posed.normals


class BentNormals(NormalModel):
    """Learned offsets dn from the third axis of a frame that turns with the pose."""

    def __init__(self, store: TexelStore, spec: AvatarSpec) -> None:
        super().__init__(store, spec)
        store.add("normal_offset", store.fill(0.0, 3))

    def bend(
        self, parameters: TexelParameters, axes: Tensor, posed: PosedTexels, added: Tensor | None = None
    ) -> Float[Tensor, "texels 3"]:
        """Normals with the offset."""
        around = self.around(axes, posed)
        offset = parameters.normal_offset if added is None else parameters.normal_offset + added
        return unit((around @ (offset + offset.new_tensor([0.0, 0.0, 1.0]))[..., None])[..., 0])

    @abstractmethod
    def around(self, axes: Tensor, posed: PosedTexels) -> Float[Tensor, "texels 3 3"]:
        """The frame that dn is kept in."""

    def penalties(self, parameters: TexelParameters) -> dict[str, Float[Tensor, ""]]:
        """Mean squared offset."""
        return {"normal": parameters.normal_offset.square().mean()}


class GaussianNormals(BentNormals):
    """dn in the Gaussian's frame (RFGCA 10)."""

    def around(self, axes: Tensor, posed: PosedTexels) -> Float[Tensor, "texels 3 3"]:
        """Axes of the Gaussians."""
        return axes


class TangentNormals(BentNormals):
    """dn in the tangent frame of the mesh (RGCA 9)."""

    def around(self, axes: Tensor, posed: PosedTexels) -> Float[Tensor, "texels 3 3"]:
        """Tangent frames of the posed mesh."""
        return posed.tangent_frames


class HeadNormals(BentNormals):
    """dn in the head's frame, added to the mesh normal (RGCA 9)."""

    def bend(
        self, parameters: TexelParameters, axes: Tensor, posed: PosedTexels, added: Tensor | None = None
    ) -> Float[Tensor, "texels 3"]:
        """Mesh normals with the offset."""
        offset = parameters.normal_offset if added is None else parameters.normal_offset + added
        return unit(posed.normals + offset @ self.around(axes, posed).T)

    def around(self, axes: Tensor, posed: PosedTexels) -> Float[Tensor, "3 3"]:
        """Axes of the head, alike for all texels."""
        return posed.world_from_head
