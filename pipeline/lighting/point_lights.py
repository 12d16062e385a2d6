"""Point lights as sums over lights take them, in torch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8
from torch import Tensor


@dataclass(frozen=True)
class PointLights:
    """Point lights, and which points each of them reaches.

    Attributes:
        positions_m: in the world, metres.
        intensities: radiant intensities, linear; one channel for white lights, three for coloured ones.
        visibility_bits: row j has the points that see light j, packed as np.packbits does; None: all of them do.
    """

    positions_m: Float[Tensor, "lights 3"]
    intensities: Float[Tensor, "lights channels"]
    visibility_bits: UInt8[np.ndarray, "lights bytes"] | None = None

    def __len__(self) -> int:
        return len(self.positions_m)

    def bits_for(self, points: int) -> UInt8[np.ndarray, "lights bytes"]:
        """Visibility bits of so many points; all set where nothing hides anything."""
        if self.visibility_bits is not None:
            return self.visibility_bits
        return np.full((len(self), (points + 7) // 8), 255, np.uint8)
