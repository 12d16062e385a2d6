"""The lights that were on in each frame, with their calibrated positions."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from pipeline.base.errors import Complaints
from pipeline.base.files import read_table

CHANNELS = ["intensity_r", "intensity_g", "intensity_b"]


@dataclass(frozen=True)
class FrameLights:
    """The lit lights of one frame. Positions in the stage frame, metres, and radiant intensities, linear RGB."""

    positions: Float64[np.ndarray, "m 3"]
    intensities: Float64[np.ndarray, "m 3"]


NO_LIGHTS = FrameLights(np.zeros((0, 3)), np.zeros((0, 3)))


def read_frame_lights(lights: Path, patterns: Path) -> dict[int, FrameLights]:
    """Lit lights per frame; a frame without any is absent.

    Args:
        lights: calibration/lights.parquet.
        patterns: patterns.parquet of book_patterns.

    Raises:
        InputError: naming every lit light without a finite position, and every intensity that is negative or not
        finite.
    """
    table, positions = read_table(patterns), read_table(lights).set_index("light")[["x", "y", "z"]].astype(np.float64)
    complaints = Complaints(patterns)
    for light in sorted(set(table.light)):
        if light not in positions.index or not np.isfinite(positions.loc[light]).all():
            complaints.add(lights, f"light {light}", expected="one finite position", found="none", hint="calibrate it")
    numbers = table[CHANNELS].to_numpy(np.float64)
    for row in table[~(np.isfinite(numbers) & (numbers >= 0)).all(1)].itertuples():
        complaints.add(
            patterns, f"frame {row.frame}, light {row.light}", expected="intensities of 0 or more", found=str(row[:])
        )
    complaints.raise_if_any()
    return {
        int(frame): FrameLights(positions.loc[rows.light].to_numpy(), rows[CHANNELS].to_numpy(np.float64))
        for frame, rows in table.groupby("frame")
    }
