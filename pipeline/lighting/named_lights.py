"""Lights of the stage by name, with the patterns of the frames."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float32, Float64

from pipeline.base.errors import InputError
from pipeline.base.files import read_table
from pipeline.lighting.frame_lights import CHANNELS


@dataclass(frozen=True)
class NamedLights:
    """All lights whose place is known.

    Attributes:
        names: in the order of the arrays.
        positions: metres.
        intensities: radiant intensity, linear RGB: the median over the frames in which each is lit.
        patterns: rows frame, light (its index) and the three intensities of it.
    """

    names: list[str]
    positions: Float64[np.ndarray, "lights 3"]
    intensities: Float64[np.ndarray, "lights 3"]
    patterns: pd.DataFrame

    def pattern(self, frame: int) -> list[list[int | float]]:
        """Index and intensities of each light that is lit in a frame."""
        rows = self.patterns[self.patterns.frame == frame]
        return [
            [int(row.light), *(round(float(getattr(row, name)), 6) for name in CHANNELS)] for row in rows.itertuples()
        ]

    def brightened(self, factors: Float32[np.ndarray, " lights"]) -> NamedLights:
        """The same lights, each brighter by a factor, in all patterns."""
        patterns = self.patterns.copy()
        patterns[CHANNELS] = patterns[CHANNELS].to_numpy() * factors[patterns.light.to_numpy(), None]
        return replace(self, intensities=self.intensities * factors[:, None], patterns=patterns)

    def moved(self, offsets_m: Float32[np.ndarray, "lights 3"]) -> NamedLights:
        """The same lights, each elsewhere by an offset."""
        return replace(self, positions=self.positions + offsets_m)


def read_named_lights(lights: Path, patterns: Path) -> NamedLights:
    """Read the calibrated lights and what they did in each frame.

    Raises:
        InputError: if no light has a place.
    """
    known = read_table(lights)
    known = known[np.isfinite(known[["x", "y", "z"]].to_numpy(np.float64)).all(1)].reset_index(drop=True)
    if known.empty:
        raise InputError(f"{lights}: expected at least one light with a finite position, found none; calibrate them")
    lit = read_table(patterns)
    lit = lit[lit.light.isin(known.light)]
    medians = lit.groupby("light")[CHANNELS].median().reindex(known.light)
    medians = medians.fillna(medians.median()).fillna(1.0)  # lights that no frame turns on are as bright as the others
    index = dict(zip(known.light, range(len(known)), strict=True))
    return NamedLights(
        [str(name) for name in known.light], known[["x", "y", "z"]].to_numpy(np.float64),
        medians.to_numpy(np.float64), lit.assign(light=lit.light.map(index)).reset_index(drop=True),
    )  # fmt: skip
