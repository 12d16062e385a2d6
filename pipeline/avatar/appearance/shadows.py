"""Shadows of the lamps: a learned factor per texel, or traced for every light."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, UInt8
from torch import Tensor

from pipeline.avatar.appearance.models import ShadowModel
from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.networks.shadow_net import ShadowNet
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.texel_store import TexelStore


class LearnedShadow(ShadowModel):
    """A factor of the shadow network from the traced irradiance maps (RFGCA 15-16)."""

    def __init__(self, store: TexelStore, spec: AvatarSpec) -> None:
        super().__init__(store, spec)
        store.shadow_net = ShadowNet(store.atlas, spec.shadow_width, spec.shadow_input, spec.shadow_levels)

    def factor(self, inputs: FrameInputs) -> Float[Tensor, " texels"]:
        """Factors from the traced maps of the frame."""
        return self.store.shadow_net(*inputs.irradiance)


class TracedShadow(ShadowModel):
    """Visibility bits of the posed mesh."""

    works_under_sky = False

    def bits(self, inputs: FrameInputs) -> UInt8[np.ndarray, "lights bytes"]:
        """Bits of the frame, traced once."""
        return inputs.visibility_bits
