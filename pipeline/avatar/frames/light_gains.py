"""Factors by which lights are brighter than their calibration says."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float32


@dataclass(frozen=True, eq=False)
class LightGains:
    """Factors of lights' intensities, by the places where the lights stand.

    Attributes:
        positions: of the lights, stage frame, metres, exactly as frames have them.
        factors: of each light.
    """

    positions: Float32[np.ndarray, "lights 3"]
    factors: Float32[np.ndarray, " lights"]

    @cached_property
    def _by_place(self) -> dict[bytes, float]:
        return {place.tobytes(): float(factor) for place, factor in zip(self.positions, self.factors, strict=True)}

    def of(self, positions: Float32[np.ndarray, "lit 3"]) -> Float32[np.ndarray, " lit"]:
        """Factors of lights at these places; 1 where none of the known ones stands."""
        return np.array([self._by_place.get(place.tobytes(), 1.0) for place in positions], np.float32)

    def as_json(self) -> list[list[float]]:
        """Rows of x, y, z, factor."""
        return np.concatenate([self.positions, self.factors[:, None]], 1).tolist()

    @staticmethod
    def from_json(rows: list[list[float]]) -> LightGains:
        """Read what `as_json` wrote."""
        table = np.array(rows, np.float32).reshape(-1, 4)
        return LightGains(np.ascontiguousarray(table[:, :3]), table[:, 3])


AS_CALIBRATED = LightGains(np.zeros((0, 3), np.float32), np.ones(0, np.float32))
"""No light is other than its calibration says."""
