"""Boxes of voxels on patches of the atlas (Lombardi et al. 2021).

The geometry of rows F, G and H of RGCA's tables. What texels radiate is that of any avatar: the voxels of a texel share
its transfer, lobe and normal. Each voxel has an opacity and a tint of its own, which multiplies the colour.
"""

from __future__ import annotations

from collections.abc import Collection

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import softplus

from pipeline.avatar.geometry.box_layout import lay_boxes
from pipeline.avatar.geometry.primitives import Primitives
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.posed_texels import PosedTexels
from pipeline.avatar.texels.texel_parameters import TexelParameters
from pipeline.avatar.texels.texel_store import TexelStore
from pipeline.geometry.rotations import matrix_from_quaternion
from pipeline.rendering.splat_conventions import Splatted
from pipeline.rendering.splat_types import CameraView, Supersampling
from pipeline.rendering.supersample import supersampled
from pipeline.rendering.volume_march import march
from pipeline.rendering.volume_types import PLAIN, AnchoredVolumes, Volumes

START_DENSE, START_CLEAR = 2.0, -6.0
"""Opacity of the layer at the surface and of that below it, before softplus, and of the others. Of a density of 1 per
spacing of layers, a layer that is crossed head on just ends a ray; softplus(2) is twice that, softplus(-6) less than
3e-3. Two layers: where the surface bends, a box's voxels are further apart than layers, and one could fall between."""


class VolumesOnTexels(Primitives):
    """Boxes that stand on the surface and may move off it."""

    def __init__(self, store: TexelStore, spec: AvatarSpec) -> None:
        self.store, self.step_m = store, spec.ray_step_m * store.unit_m
        self.sampling = Supersampling(spec.supersample, spec.pixel_filter, spec.filter_std_px)
        layout = lay_boxes(store.atlas, store.spacing.numpy(), spec.box_voxels)
        for name, tensor in layout.named().items():
            store.register_buffer(f"box_{name}", tensor, persistent=False)
        self.network_atlas = store.atlas.chosen(layout.anchor.numpy())
        boxes, layers = len(layout.anchor), spec.box_voxels
        store.add("offset", torch.zeros(boxes, 3))
        store.add("rotation", torch.tensor([1.0, 0, 0, 0]).repeat(boxes, 1))
        store.add("log_scale", layout.half_size.log())
        opacity = store.fill(START_CLEAR, layers)
        surface = (layers - 1) // 2
        opacity[:, max(surface - 1, 0) : surface + 1] = START_DENSE
        store.add("opacity", opacity)
        store.add("log_tint", store.fill(0.0, layers, 3))

    def place(
        self, parameters: TexelParameters, posed: PosedTexels
    ) -> tuple[AnchoredVolumes, Float[Tensor, "texels 3 3"]]:
        """Boxes at their anchors plus what they moved by.

        What they show is evaluated at the texels themselves.
        """
        store = self.store
        frames = posed.tangent_frames[store.box_anchor]
        moved = (frames @ (store.box_shift + parameters.offset)[..., None])[..., 0]
        rotations = frames @ matrix_from_quaternion(parameters.rotation)
        density = softplus(parameters.opacity) / store.box_thickness_m
        # One row per layer of each texel: density, then tint.
        rows = torch.cat([density[..., None], store.log_tint.exp()], -1).flatten(0, 1)
        low, high = (rows[index.flatten()].reshape(*index.shape, 4) for index in (store.box_lower, store.box_upper))
        voxels = low + store.box_share[..., None] * (high - low)
        volumes = Volumes(
            posed.points[store.box_anchor] + moved, rotations, parameters.log_scale.exp(),
            voxels[..., 0] * store.box_filled, voxels[..., 1:],
        )  # fmt: skip
        return AnchoredVolumes(volumes, posed.points), posed.tangent_frames

    def draw(
        self, primitives: AnchoredVolumes, features: Float[Tensor, "texels d"], camera: CameraView,
        colors: Collection[int] = (0,),
    ) -> Splatted:  # fmt: skip
        """March rays through the boxes, supersampled."""
        index = self.store.box_texel
        columns = features[index.flatten()].reshape(*index.shape, -1)
        tinted = [PLAIN] * features.shape[1]
        for first in colors:
            tinted[first : first + 3] = (0, 1, 2)
        return supersampled(
            lambda large: march(primitives.volumes, columns, tuple(tinted), large, self.step_m), camera, self.sampling
        )
