"""Light patterns as lists of lights and durations, a schema that several sets share."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pipeline.base.errors import InputError, listed
from pipeline.base.files import read_json
from pipeline.datasets.imported_capture import Provenance
from pipeline.datasets.kept_frames import shown
from pipeline.datasets.layout import json_key

log = logging.getLogger(__name__)

FULLY_LIT = 0
"""Number of the pattern with all lights on."""

Pattern = dict[int, float]
"""Light -> how long it was on, in the set's own unit."""


def light_name(number: int) -> str:
    """Name of a light by its number in the set."""
    return f"L{number:03d}"


def read_lights(path: Path, metres_per_unit: float) -> pd.DataFrame:
    """light, x, y, z of the lights of a pattern file, in metres.

    Raises:
        InputError: if there are no positions of three finite numbers.
    """
    try:
        places = np.array(json_key(path, "light_positions"), np.float64) * metres_per_unit
    except (TypeError, ValueError):  # Rows of unequal length, text.
        places = np.zeros(0)
    if places.ndim != 2 or places.shape[1:] != (3,) or not len(places) or not np.isfinite(places).all():
        raise InputError(f"{path}: light_positions: expected rows of three finite numbers, found others")
    names = [light_name(number) for number in range(len(places))]
    return pd.DataFrame({"light": names, **dict(zip("xyz", places.T, strict=True))})


def read_durations(path: Path, key: str, lights: int) -> list[Pattern]:
    """The patterns of a pattern file; entries of one light add up.

    Args:
        key: what the file calls its list of patterns.
        lights: number of lights that there are.

    Raises:
        InputError: if a pattern names a light that there is none, or no number.
    """
    patterns: list[Pattern] = []
    for number, entry in enumerate(json_key(path, key)):
        try:
            pairs = [(int(light), float(duration)) for light, duration in entry["light_index_durations"]]
        except (KeyError, TypeError, ValueError) as error:
            expected = "light_index_durations, pairs of a light and a duration"
            raise InputError(f"{path}: {key}[{number}]: expected {expected}, found {entry!r:.80}") from error
        wrong = [light for light, duration in pairs if not 0 <= light < lights or not duration >= 0]
        if wrong:
            expected = f"lights 0 to {lights - 1}, on for 0 or longer"
            raise InputError(f"{path}: {key}[{number}]: expected {expected}, found light {listed(wrong)}")
        pattern: Pattern = {}
        for light, duration in pairs:
            pattern[light] = pattern.get(light, 0.0) + duration
        patterns.append(pattern)
    return patterns


def read_pattern_of_frames(path: Path, patterns: int) -> dict[int, int]:
    """Number of the pattern by frame.

    Raises:
        InputError: if an entry is no pair, names a pattern that there is none, or a frame has two.
    """
    content: Any = read_json(path)
    try:
        pairs = [(int(frame), int(pattern)) for frame, pattern in content]
    except (TypeError, ValueError) as error:
        raise InputError(f"{path}: expected pairs of a frame and a pattern, found {content!r:.80}") from error
    if wrong := [frame for frame, pattern in pairs if not 0 <= pattern < patterns]:
        raise InputError(f"{path}: expected patterns 0 to {patterns - 1}, found others in frame {listed(wrong)}")
    found = dict(pairs)
    if twice := sorted(frame for frame, pattern in pairs if found[frame] != pattern):
        raise InputError(f"{path}: expected one pattern per frame, found two for frame {listed(twice)}")
    return found


def lit_lights(patterns: Sequence[Pattern], lights: int, provenance: Provenance) -> list[str]:
    """Names of the lights that any pattern turns on; the others are named."""
    ever = {light for pattern in patterns for light, duration in pattern.items() if duration > 0}
    full = {light for light, duration in patterns[FULLY_LIT].items() if duration > 0}
    if never := [light_name(light) for light in range(lights) if light not in ever]:
        provenance.left_out["lights that no pattern turns on"] = shown(never)
    if dark := sorted(ever - full):
        names = listed([light_name(light) for light in dark])
        log.warning("pattern %d is taken for fully lit, but leaves out %s: no frame will count as it", FULLY_LIT, names)
    return [light_name(light) for light in sorted(ever)]


def intensities(
    frames: Sequence[int], pattern_of: dict[int, int], patterns: Sequence[Pattern], full_duration: float,
    partial_gain: float = 1.0,
) -> pd.DataFrame:  # fmt: skip
    """frame, light, intensity of each lit light.

    Args:
        full_duration: that of intensity 1.
        partial_gain: factor on intensities in frames that are not fully lit.
    """
    numbers = [pattern_of[frame] for frame in frames]
    lit, found = {}, {}
    for number in set(numbers):
        gain = 1.0 if number == FULLY_LIT else partial_gain
        on = {light: duration for light, duration in sorted(patterns[number].items()) if duration > 0}
        lit[number] = np.fromiter(on, np.int64, len(on))
        found[number] = np.array([duration / full_duration * gain for duration in on.values()], np.float64)
    counts = [len(lit[number]) for number in numbers]
    lights = np.concatenate([lit[number] for number in numbers]) if numbers else np.zeros(0, np.int64)
    names = np.array([light_name(light) for light in range(int(lights.max(initial=-1)) + 1)], object)
    table = {
        "frame": np.repeat(np.array(frames, np.int64), counts), "light": pd.Series(names[lights], dtype="str"),
        "intensity": np.concatenate([found[number] for number in numbers]) if numbers else np.zeros(0),
    }  # fmt: skip
    return pd.DataFrame(table)
