"""Which LED was on in which frame, how bright that should look, and which frames do not fit."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from jaxtyping import Float64

from pipeline.geometry.cameras import Camera

MAD_TO_SIGMA = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation, 1 / Phi^-1(3/4)."""

SMALLEST_SPREAD = 0.05
"""Robust spread of log brightness ratios below which it is not believed: exposure and LEDs repeat to a few percent,
and a spread of 0 (a still subject) would make every frame suspicious."""

GROUP_FOR_ITS_OWN_MEDIAN = 8
"""Frames of one kind (fully or partially lit) from which they get a median of their own: a median of fewer is noise."""

DARK_SHARE = 1e-3
"""Share of the median below which a brightness counts as dark; keeps the logarithm of a ratio finite."""


def book_frames(frames: pd.DataFrame, images: pd.DataFrame, patterns: pd.DataFrame, lights: list[str]) -> pd.DataFrame:
    """One row per frame: frame, timestamp_s, segment, lights_on, fully_lit, split.

    Args:
        frames, images, patterns: tables of the index; `patterns` in the numbering of the images.
        lights: every LED of the stage; a frame that lists all of them is fully lit.
    """
    lit = patterns[patterns.intensity > 0].groupby("frame").light.nunique()
    flags = images.groupby("frame")[["test_frame", "test_segment"]].any()
    booked = frames[["frame", "timestamp_s", "segment"]].sort_values("frame").reset_index(drop=True)
    booked["lights_on"] = booked.frame.map(lit).fillna(0).astype(np.int64)
    booked["fully_lit"] = booked.lights_on == len(lights)
    held_out = flags.reindex(booked.frame, fill_value=False).astype(bool)
    booked["split"] = np.select(
        [held_out.test_segment.to_numpy(), held_out.test_frame.to_numpy()], ["test_segments", "test_frames"], "train"
    )
    return booked


def book_patterns_rgb(patterns: pd.DataFrame, booked: pd.DataFrame) -> pd.DataFrame:
    """One row per lit light of a booked frame: frame, light, intensity_r, intensity_g, intensity_b, fully_lit, split.

    LEDs are white: their three intensities are equal, and white means what the colour chart calls white.
    """
    table = patterns[patterns.intensity > 0].merge(booked[["frame", "fully_lit", "split"]], on="frame")
    for channel in "rgb":
        table[f"intensity_{channel}"] = table.intensity.astype(np.float64)
    columns = ["frame", "light", "intensity_r", "intensity_g", "intensity_b", "fully_lit", "split"]
    return table[columns].sort_values(["frame", "light"]).reset_index(drop=True)


def shift_patterns(patterns: pd.DataFrame, frames: pd.DataFrame, offset: int) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Renumber patterns to the images' frames, where images of frame f show the pattern logged for f + `offset`.

    Returns patterns and frames; frames whose pattern was never logged are dropped.
    """
    known = frames[(frames.frame + offset).isin(frames.frame)]
    moved = patterns.assign(frame=patterns.frame - offset)
    return moved[moved.frame.isin(known.frame)].reset_index(drop=True), known.reset_index(drop=True)


def predicted_brightness(
    patterns: pd.DataFrame, lights: pd.DataFrame, frames: pd.Series, center: Float64[np.ndarray, " 3"]
) -> pd.Series:
    """Irradiance at the subject's centre per frame, sum of I / d^2 over its lit lights; 0 in the dark."""
    squared = pd.Series(((lights[["x", "y", "z"]].to_numpy() - center) ** 2).sum(1), lights.light.to_numpy())
    terms = patterns.intensity / patterns.light.map(squared)
    return terms.groupby(patterns.frame).sum().reindex(frames.to_numpy(), fill_value=0.0).rename("predicted")


def observed_brightness(means: pd.DataFrame) -> pd.Series:
    """Brightness per frame, averaged over cameras: columns camera, frame, brightness -> indexed by frame.

    Each camera is divided by its own mean over frames first, so that neither its gain nor a missing image matters.
    """
    share = means.brightness / means.groupby("camera").brightness.transform("mean").replace(0, np.nan)
    return share.groupby(means.frame).mean().rename("observed")


def subject_center(
    cameras: Mapping[str, Camera], pixels: Mapping[str, Float64[np.ndarray, " 2"]]
) -> Float64[np.ndarray, " 3"]:
    """The point nearest to the rays through one pixel per camera (least squares), metres, world."""
    normal, right = np.zeros((3, 3)), np.zeros(3)
    for name, pixel in pixels.items():
        direction = cameras[name].ray_directions(np.asarray(pixel)[None])[0]
        across = np.eye(3) - np.outer(direction, direction)
        normal, right = normal + across, right + across @ cameras[name].center
    # The minimum-norm solution: a single camera, or parallel ones, leave the distance open.
    return np.linalg.lstsq(normal, right, rcond=None)[0]


def suspicious_frames(booked: pd.DataFrame, sigmas: float) -> pd.Series:
    """Frames whose observed / predicted brightness is an outlier: beyond `sigmas` robust deviations in the logarithm.

    Fully and partially lit frames are compared among themselves where there are enough: a few lights from one side
    brighten a body less than the same light from everywhere. Frames without images are not suspicious.
    """
    suspicious = pd.Series(False, booked.index)
    for _, group in booked[booked.observed.notna()].groupby(_lighting_group(booked)):
        floor = DARK_SHARE * group[["predicted", "observed"]].median().clip(lower=np.finfo(float).tiny)
        ratio = np.log(group.observed.clip(lower=floor.observed) / group.predicted.clip(lower=floor.predicted))
        # Dark as logged and dark as seen is no ratio, and no surprise.
        both_dark = (group.predicted <= floor.predicted) & (group.observed <= floor.observed)
        center = ratio[~both_dark].median()
        spread = max(MAD_TO_SIGMA * (ratio[~both_dark] - center).abs().median(), SMALLEST_SPREAD)
        suspicious[group.index] = ((ratio - center).abs() > sigmas * spread) & ~both_dark
    return suspicious


def _lighting_group(booked: pd.DataFrame) -> pd.Series:
    counts = booked[booked.observed.notna()].fully_lit.value_counts()
    if len(counts) == 2 and counts.min() >= GROUP_FOR_ITS_OWN_MEDIAN:
        return booked.fully_lit
    return pd.Series(False, booked.index)
