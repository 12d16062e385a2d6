"""Light of an environment map in the forms that shading asks for."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from pipeline.lighting.environment_lobes import LobeLadder
from pipeline.lighting.point_lights import PointLights


@dataclass(frozen=True)
class PreparedSky:
    """A map's light, which stays in the map's own frame.

    A map that is turned turns what asks for light the other way instead, so that neither harmonics nor prefiltered
    panoramas are made again.

    Attributes:
        harmonics: L_lm of `pipeline.lighting.environment_sh`, linear RGB.
        ladder: prefiltered panoramas; None for an avatar without specular lobe.
        world_from_map: rotation of the map.
        pixels: its light as far lamps, for what has to know which of them something hides; None if nothing has.
    """

    harmonics: Float[Tensor, "81 3"]
    ladder: LobeLadder | None
    world_from_map: Float[Tensor, "3 3"]
    pixels: PointLights | None = None
