"""Lights of Goliath's heads and hands, and the pattern of each frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from pipeline.datasets.goliath_cameras import METRES_PER_UNIT
from pipeline.datasets.imported_capture import Provenance
from pipeline.datasets.light_durations import (
    Pattern,
    intensities,
    lit_lights,
    read_durations,
    read_lights,
    read_pattern_of_frames,
)

FULL_DURATION = 5555.0
"""Duration of intensity 1 in the set's loader."""


@dataclass(frozen=True)
class GoliathLights:
    """Lights and patterns of a capture's folder `lights`.

    Attributes:
        places: light, x, y, z, metres.
        patterns: durations of lit lights, by the pattern's number.
        pattern_of: number of the pattern, by frame.
    """

    places: pd.DataFrame
    patterns: list[Pattern]
    pattern_of: dict[int, int]

    def tables(self, frames: Sequence[int], provenance: Provenance) -> tuple[pd.DataFrame, pd.DataFrame]:
        """Tables of lights that are ever lit, and of those lit in each of the frames."""
        lit = lit_lights(self.patterns, len(self.places), provenance)
        # As the set's loader does: durations are whole numbers.
        whole = [{light: float(int(duration)) for light, duration in pattern.items()} for pattern in self.patterns]
        placed = self.places[self.places.light.isin(lit)].reset_index(drop=True)
        return placed, intensities(frames, self.pattern_of, whole, FULL_DURATION)


def read_goliath_lights(root: Path) -> GoliathLights:
    """The lights of a capture.

    Raises:
        InputError: if a file says something else than light positions, durations or patterns of frames.
    """
    path = root / "lights/light_pattern_metadata.json"
    places = read_lights(path, METRES_PER_UNIT)
    patterns = read_durations(path, "light_patterns", len(places))
    return GoliathLights(
        places, patterns, read_pattern_of_frames(root / "lights/light_pattern_per_frame.json", len(patterns))
    )
