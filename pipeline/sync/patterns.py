"""Synced tables of frames and lit LEDs: names of patterns, splits, leaks and mending."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from pipeline.base.splits import VALIDATION
from pipeline.lighting.frame_lights import CHANNELS

VALIDATION_EVERY = 8
"""Of so many training frames, one is for validation: the others lose little by it, and a usual recording of dozens of
frames still has several, of which a mean can be taken."""

SAME_INTENSITY = 1e-6
"""Intensities this close, relative to the log's largest, are one: decimals of a table, not a choice of light."""

SAME_LIGHT = 0.01
"""Patterns of the same lights whose relative intensities differ by less show a model the same light: LEDs themselves
repeat to a percent, and brightness as such teaches nothing new."""


def synced_frames(
    frames: pd.DataFrame, images: pd.DataFrame, patterns: pd.DataFrame, lights: list[str]
) -> pd.DataFrame:
    """Table of frames: when, in which segment, how lit, under which pattern and in which split.

    Columns are frame, timestamp_s, segment, lights_on, fully_lit, pattern, test_pattern, split, validation. `pattern`
    names the lit lights with their intensities by the first frame that shows them; `test_pattern` says whether that is
    the pattern of a frame that `splits.test_patterns` lists; `validation`, whether choices are made on the frame.

    Args:
        frames, images, patterns: tables of the index; `patterns` in the numbering of the images.
        lights: every LED of the stage that works; a frame that lights all of them is fully lit.
    """
    lit = patterns[patterns.light.isin(lights)].groupby("frame").light.nunique()
    named = images[["validation_frame", "validation_pattern"]].notna().all(axis=None)
    columns = ["test_frame", "test_segment", "test_pattern", "validation_frame", "validation_pattern"]
    flags = images[columns].fillna(False).astype(bool).groupby(images.frame).any()
    synced = frames[["frame", "timestamp_s", "segment"]].sort_values("frame").reset_index(drop=True)
    synced["lights_on"] = synced.frame.map(lit).fillna(0).astype(np.int64)
    synced["fully_lit"] = synced.lights_on == len(lights)
    synced["pattern"] = name_patterns(patterns, synced.frame)
    held_out = flags.reindex(synced.frame, fill_value=False).astype(bool).reset_index(drop=True)
    synced["test_pattern"] = synced.pattern.isin(synced.pattern[held_out.test_pattern])
    synced["split"] = np.select(
        [held_out.test_segment, held_out.test_frame, synced.test_pattern],
        ["test_segments", "test_frames", "test_patterns"], "train",
    )  # fmt: skip
    chosen = held_out.validation_frame | synced.pattern.isin(synced.pattern[held_out.validation_pattern])
    synced["validation"] = (synced.split == "train") & (chosen if named else choose_validation(synced))
    synced.loc[synced.validation, "split"] = VALIDATION
    return synced


def choose_validation(synced: pd.DataFrame) -> pd.Series:
    """Frames for validation where the capture names none: an eighth of those that would train.

    They are spread evenly over the fully lit frames, and over the patterns of the partially lit ones, whose frames are
    held out together. Of less than eight, none is spared.

    Args:
        synced: frame, pattern, lights_on, fully_lit and split of every frame.
    """
    train = synced.split == "train"
    partial = train & ~synced.fully_lit & (synced.lights_on > 0)
    frames = spread_share(synced.frame[train & synced.fully_lit].unique())
    patterns = spread_share(synced.pattern[partial].unique())
    return synced.frame.isin(frames) | (partial & synced.pattern.isin(patterns))


def spread_share(values: np.ndarray) -> np.ndarray:
    """One of every `VALIDATION_EVERY` values, evenly spread over their order."""
    count = len(values) // VALIDATION_EVERY
    return values[((np.arange(count) + 0.5) * len(values) / max(count, 1)).astype(int)]


def name_patterns(patterns: pd.DataFrame, frames: pd.Series) -> pd.Series:
    """Name of each frame's pattern: the first frame that shows the same lights alike."""
    unit = SAME_INTENSITY * max(float(patterns[CHANNELS].to_numpy().max(initial=0.0)), np.finfo(float).tiny)
    steps = patterns.assign(**{channel: (patterns[channel] / unit).round() for channel in CHANNELS})
    shown = {
        frame: tuple(rows.sort_values("light")[["light", *CHANNELS]].itertuples(index=False, name=None))
        for frame, rows in steps.groupby("frame")
    }
    first: dict[tuple, int] = {}
    return frames.map(lambda frame: first.setdefault(shown.get(frame, ()), frame))


def find_leaks(synced: pd.DataFrame, patterns: pd.DataFrame) -> list[tuple[int, int]]:
    """Pairs (held-out frame, training frame) that show the same light.

    Testing on them would ask what was taught. The same light is the same lit lights with intensities in the same
    proportions. Held out are the frames of a held-out pattern, and partially lit test frames; that fully lit ones
    repeat is what they are for.
    """
    partial_tests = (synced.split == "test_frames") & ~synced.fully_lit & (synced.lights_on > 0)
    asked = set(synced.frame[synced.test_pattern | partial_tests])
    taught = set(synced.frame[synced.split == "train"])
    alike: dict[tuple, list[tuple[int, np.ndarray]]] = {}
    for frame, rows in patterns[patterns.frame.isin(asked | taught)].sort_values("light").groupby("frame"):
        levels = rows[CHANNELS].to_numpy(np.float64)
        alike.setdefault(tuple(rows.light), []).append((int(frame), levels / levels.max()))
    return [
        (test, train)
        for group in alike.values()
        for test, wanted in group if test in asked
        for train, known in group if train in taught and np.abs(wanted - known).max() < SAME_LIGHT
    ]  # fmt: skip


def synced_patterns(patterns: pd.DataFrame, synced: pd.DataFrame) -> pd.DataFrame:
    """Table of lit lights, one row per frame and light.

    Columns are frame, light, intensity_r, intensity_g, intensity_b, fully_lit, split.
    """
    table = patterns.merge(synced[["frame", "fully_lit", "split"]], on="frame")
    columns = ["frame", "light", *CHANNELS, "fully_lit", "split"]
    return table[columns].sort_values(["frame", "light"]).reset_index(drop=True)


def mend_patterns(
    patterns: pd.DataFrame, frames: pd.DataFrame, found: pd.DataFrame, constants: Mapping[str, np.ndarray]
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Mend patterns as the check says: those that were on, numbered as images, and their frames.

    Frames whose pattern was never logged, and those that do not show their pattern, are dropped. Frames without images
    move with those before them.

    Args:
        found: per frame with images: frame, offset_frames, suspicious, as of `SyncCheck.frames`.
        constants: lights that have one level in all frames, linear RGB; 0 for dead ones.
    """
    offsets = found.set_index("frame").offset_frames.reindex(frames.frame.sort_values()).ffill().bfill()
    logged = pd.DataFrame({"frame": offsets.index, "logged": (offsets.index + offsets).astype(np.int64)})
    known = logged.logged.isin(frames.frame) | logged.logged.isin(patterns.frame)
    logged = logged[known & ~logged.frame.isin(found.frame[found.suspicious])]
    moved = patterns.rename(columns={"frame": "logged"}).merge(logged, on="logged").drop(columns="logged")
    moved = moved[~moved.light.isin(list(constants))]
    for light, levels in constants.items():
        if (levels > 0).any():
            always = logged[["frame"]].assign(light=light, **dict(zip(CHANNELS, levels, strict=True)))
            moved = pd.concat([moved, always])
    left = frames[frames.frame.isin(logged.frame)].reset_index(drop=True)
    return moved.sort_values(["frame", "light"]).reset_index(drop=True)[["frame", "light", *CHANNELS]], left
