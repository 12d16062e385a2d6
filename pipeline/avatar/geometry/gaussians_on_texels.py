"""One Gaussian per texel, splatted (RFGCA 5-6, RGCA 3)."""

from __future__ import annotations

from collections.abc import Collection

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.avatar.geometry.primitives import Primitives
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.posed_texels import PosedTexels, pose_texels
from pipeline.avatar.texels.texel_parameters import TexelParameters
from pipeline.avatar.texels.texel_store import TexelStore
from pipeline.geometry.rotations import matrix_from_quaternion, multiply_quaternions, quaternion_from_matrix
from pipeline.rendering.splat_conventions import MIN_NEAR_M, Splatted
from pipeline.rendering.splat_types import CameraView, Gaussians, SplatOptions, Supersampling
from pipeline.rendering.supersample import splat_supersampled

START_OPACITY = 0.95
START_FILL = 0.6
"""A Gaussian's standard deviation along the surface, in texel spacings: neighbours' weights then sum to within 3 % of
a constant, so the start surface is closed and even."""

START_THICKNESS = 0.1
"""Standard deviation along the normal, in texel spacings: a thin disc."""


class GaussiansOnTexels(Primitives):
    """Thin discs that cover the surface and may move off it."""

    def __init__(self, store: TexelStore, spec: AvatarSpec) -> None:
        self.options = SplatOptions(
            spec.dilation_px2, spec.compensate_opacity, max(SplatOptions.near_m * store.unit_m, MIN_NEAR_M),
            spec.pixel_depth == "median",
        )  # fmt: skip
        self.sampling = Supersampling(spec.supersample, spec.pixel_filter, spec.filter_std_px)
        spacing = store.spacing
        thickness = START_THICKNESS * spacing.mean(-1, keepdim=True)
        store.add("offset", store.fill(0.0, 3))
        store.add("rotation", torch.tensor([1.0, 0, 0, 0]).repeat(len(spacing), 1))
        store.add("log_scale", torch.cat([START_FILL * spacing, thickness], -1).log())
        store.add("opacity", store.fill(START_OPACITY).logit())

    def place(self, parameters: TexelParameters, posed: PosedTexels) -> tuple[Gaussians, Float[Tensor, "texels 3 3"]]:
        """R_k = TBN_k dR_k (RFGCA 6), and the means beside their anchors (RFGCA 5)."""
        axes = posed.tangent_frames @ matrix_from_quaternion(parameters.rotation)
        quaternions = multiply_quaternions(posed.quaternions, parameters.rotation)
        means = posed.points + (posed.tangent_frames @ parameters.offset[..., None])[..., 0]
        return Gaussians(means, quaternions, parameters.log_scale.exp(), torch.sigmoid(parameters.opacity)), axes

    def draw(
        self, primitives: Gaussians, features: Float[Tensor, "texels d"], camera: CameraView,
        colors: Collection[int] = (0,),
    ) -> Splatted:  # fmt: skip
        """Splat, supersampled; all channels alike."""
        return splat_supersampled(primitives, features, camera, self.options, self.sampling)


class GaussiansInHead(GaussiansOnTexels):
    """Discs whose offsets and rotations are kept in the head's frame (RGCA 3)."""

    def __init__(self, store: TexelStore, spec: AvatarSpec) -> None:
        super().__init__(store, spec)
        with torch.no_grad():  # Discs lie on the surface at rest.
            store.rotation.copy_(pose_texels(store.atlas, store.atlas.rest_vertices).quaternions)

    def place(self, parameters: TexelParameters, posed: PosedTexels) -> tuple[Gaussians, Float[Tensor, "texels 3 3"]]:
        """t_k = v_k + dt_k and R_k (RGCA 3), turned to the world."""
        turn = posed.world_from_head
        axes = turn @ matrix_from_quaternion(parameters.rotation)
        quaternions = multiply_quaternions(head_quaternion(turn).expand(len(axes), -1), parameters.rotation)
        means = posed.points + parameters.offset @ turn.T
        return Gaussians(means, quaternions, parameters.log_scale.exp(), torch.sigmoid(parameters.opacity)), axes


def head_quaternion(turn: Float[Tensor, "3 3"]) -> Float[Tensor, "4"]:
    """A rotation that is no parameter, as a quaternion."""
    return torch.as_tensor(quaternion_from_matrix(turn.detach().double().cpu().numpy())).to(turn)
