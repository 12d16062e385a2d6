"""Parameters of texels that follow pose or expression, in one frame."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields, replace

from jaxtyping import Float
from torch import Tensor

POSED = ("offset", "rotation", "log_scale", "opacity", "transfer_color", "transfer_mono", "normal_offset")
"""Parameters of a texel that a pose may change (RFGCA 4), if the avatar has them; albedo and roughness never do."""

PLACED = ("offset", "rotation", "log_scale")
"""Parameters of primitives, of which boxes have fewer than there are texels."""

GEOMETRY = (*PLACED, "opacity")
"""Parameters of what is drawn, whatever its colour: an avatar may take another's (`geometry_from`)."""

EXPRESSED = (*POSED, "log_roughness")
"""Parameters that an expression may change (RGCA 3, 9)."""


@dataclass(frozen=True)
class TexelParameters:
    """Parameters of all texels in one frame.

    Their own, plus what networks add; None where an avatar has none.

    Attributes:
        offset: of the primitive from its anchor, in the tangent frame, metres (RFGCA 5). Gaussians: one on each texel.
        rotation: quaternion of the primitive in the tangent frame (RFGCA 6).
        log_scale: logarithms of the standard deviations, metres; of boxes, of the half sizes.
        opacity: logits; of boxes, densities of a texel's layers before softplus.
        transfer_color, transfer_mono: coefficients of the diffuse transfer; see `pipeline.avatar.appearance.transfer`.
        normal_offset: dn of the shading normal (RFGCA 10, RGCA 9).
        log_roughness: logarithm of the specular lobe's width, radians.
    """

    offset: Float[Tensor, "primitives 3"]
    rotation: Float[Tensor, "primitives 4"]
    log_scale: Float[Tensor, "primitives 3"]
    opacity: Float[Tensor, " texels *layers"]
    transfer_color: Float[Tensor, " texels *color"] | None = None
    transfer_mono: Float[Tensor, " texels *mono"] | None = None
    normal_offset: Float[Tensor, "texels 3"] | None = None
    log_roughness: Float[Tensor, " texels"] | None = None

    def named(self, names: Collection[str] = EXPRESSED) -> dict[str, Tensor]:
        """The parameters of these names, where there are any."""
        own = {field.name: getattr(self, field.name) for field in fields(self) if field.name in names}
        return {name: tensor for name, tensor in own.items() if tensor is not None}

    def plus(self, added: Mapping[str, Tensor]) -> TexelParameters:
        """The parameters with what networks add to some of them."""
        return replace(self, **{name: getattr(self, name) + tensor for name, tensor in added.items()})
