"""Factors of the lights' calibrated brightness, and offsets of their places."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float32

COLUMNS = 7
"""Numbers of a light in files: place, factor, offset."""


@dataclass(frozen=True, eq=False)
class LightGains:
    """Factors of lights' intensities and offsets of their places, by their calibrated places.

    Attributes:
        positions: of the lights, stage frame, metres, exactly as frames have them.
        factors: of each light.
        offsets_m: of each light's place, metres; None: they stand where they were.
    """

    positions: Float32[np.ndarray, "lights 3"]
    factors: Float32[np.ndarray, " lights"]
    offsets_m: Float32[np.ndarray, "lights 3"] | None = None

    @cached_property
    def _by_place(self) -> dict[bytes, int]:
        return {place.tobytes(): number for number, place in enumerate(self.positions)}

    def of(self, positions: Float32[np.ndarray, "lit 3"]) -> Float32[np.ndarray, " lit"]:
        """Factors of lights at these places; 1 where none of the known ones stands."""
        return np.append(self.factors, np.float32(1))[self._numbers(positions)]

    def moved(self, positions: Float32[np.ndarray, "lit 3"]) -> Float32[np.ndarray, "lit 3"]:
        """Move these places to where the lights stand that the calibration has there."""
        if self.offsets_m is None:
            return positions
        return positions + np.append(self.offsets_m, np.zeros((1, 3), np.float32), 0)[self._numbers(positions)]

    def _numbers(self, positions: np.ndarray) -> list[int]:
        """Numbers of the lights at these places; that of none is one more than the last."""
        return [self._by_place.get(place.tobytes(), len(self.positions)) for place in positions]

    def as_json(self) -> list[list[float]]:
        """Rows of x, y, z and factor, then x, y and z of the offset if there are offsets."""
        offsets = [] if self.offsets_m is None else [self.offsets_m]
        return np.concatenate([self.positions, self.factors[:, None], *offsets], 1).tolist()

    @staticmethod
    def from_json(rows: list[list[float]]) -> LightGains:
        """Read what `as_json` wrote."""
        table = np.zeros((len(rows), COLUMNS), np.float32)
        for row, numbers in zip(table, rows, strict=True):
            row[: len(numbers)] = numbers
        offsets = np.ascontiguousarray(table[:, 4:])
        return LightGains(np.ascontiguousarray(table[:, :3]), table[:, 3], offsets if offsets.any() else None)


AS_CALIBRATED = LightGains(np.zeros((0, 3), np.float32), np.ones(0, np.float32))
"""No light is other than its calibration says."""
