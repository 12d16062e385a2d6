"""Writing light patterns in Goliath's layout.

A light is on for a whole duration, of which 5555 is an intensity of 1.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.errors import InputError, listed
from pipeline.base.files import write_json
from pipeline.datasets.goliath_cameras import METRES_PER_UNIT
from pipeline.datasets.goliath_lights import FULL_DURATION
from pipeline.lighting.frame_lights import CHANNELS

log = logging.getLogger(__name__)


def write_patterns(folder: Path, lights: pd.DataFrame, patterns: pd.DataFrame, frames: Sequence[int]) -> None:
    """Write light_pattern_metadata.json and light_pattern_per_frame.json.

    Lights become numbers, in the order of their names; pattern 0 is the fully lit one.

    Args:
        lights: light, x, y, z, metres.
        patterns: frame, light and intensities, a row for each lit light.
        frames: those that are written.

    Raises:
        InputError: if a light has no place, or not the same intensity in all channels.
    """
    places = lights.sort_values("light", ignore_index=True)
    number = {str(name): k for k, name in enumerate(places.light)}
    lit = patterns[patterns.frame.isin(frames)]
    if unknown := sorted(set(lit.light.astype(str)) - set(number)):
        raise InputError(
            f"--lights: expected the place of every light, found none of {listed(unknown)}; calibrate them"
        )
    channels = lit[CHANNELS].to_numpy(np.float64)
    if colored := sorted(set(lit.light.astype(str)[np.ptp(channels, axis=1) > 0])):
        raise InputError(
            f"layout goliath: expected lights of one intensity in all channels, found others of {listed(colored)}; "
            "export colmap or nerfstudio, which hold no lights"
        )
    of_frame = {int(frame): _durations(rows, number) for frame, rows in lit.groupby("frame")}
    distinct = {tuple(map(tuple, of_frame.get(frame, []))) for frame in frames}
    full = [durations for durations in distinct if len(durations) == len(number)]
    if not full:
        log.warning("no frame is fully lit: pattern 0, which the set keeps for that, has no frame")
    first = min(full) if full else tuple((k, int(FULL_DURATION)) for k in number.values())
    ordered = [first, *sorted(distinct - {first})]
    index = {durations: k for k, durations in enumerate(ordered)}
    write_json(
        folder / "light_pattern_metadata.json",
        {
            "light_positions": (places[["x", "y", "z"]].to_numpy(np.float64) / METRES_PER_UNIT).tolist(),
            "light_patterns": [{"light_index_durations": [list(pair) for pair in pattern]} for pattern in ordered],
        },
    )
    per_frame = [[frame, index[tuple(map(tuple, of_frame.get(frame, [])))]] for frame in frames]
    write_json(folder / "light_pattern_per_frame.json", per_frame)


def _durations(rows: pd.DataFrame, number: dict[str, int]) -> list[list[int]]:
    durations = np.round(FULL_DURATION * rows[CHANNELS[1]].to_numpy(np.float64)).astype(int)
    return sorted([number[str(light)], int(time)] for light, time in zip(rows.light, durations, strict=True) if time)
