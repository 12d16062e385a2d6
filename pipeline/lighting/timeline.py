"""One picture of a capture's lighting over time: which LED was on, what was predicted and seen, and the sync check."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pipeline.base.files import written_whole
from pipeline.lighting.sync import SyncCheck

SPLIT_COLORS = {"test_frames": "tab:orange", "test_segments": "tab:purple"}
INCHES_PER_FRAME, NARROWEST_INCHES, WIDEST_INCHES = 0.12, 9.0, 40.0


def draw_timeline(
    path: Path, booked: pd.DataFrame, patterns: pd.DataFrame, lights: list[str], check: SyncCheck
) -> None:
    """Write a PNG of three rows: brightness per frame, LED x frame, correlation against offset.

    Args:
        booked: frame, fully_lit, split, predicted, observed, suspicious.
        patterns: frame, light, intensity_r, in the numbering of the images.
        lights: rows of the LED picture.
    """
    width = float(np.clip(INCHES_PER_FRAME * len(booked), NARROWEST_INCHES, WIDEST_INCHES))
    figure = Figure(figsize=(width, 9), layout="constrained")
    brightness, leds, offsets = figure.subplots(3, 1, height_ratios=[3, 3, 2])
    _draw_brightness(brightness, booked)
    _draw_leds(leds, booked, patterns, lights)
    leds.sharex(brightness)
    _draw_offsets(offsets, check)
    with written_whole(path) as temporary:
        figure.savefig(temporary, format="png", dpi=100)


def _draw_brightness(axes: Axes, booked: pd.DataFrame) -> None:
    for column, style in (("predicted", "o-"), ("observed", "s--")):
        # Each over its own mean: the unit of one is an LED's, of the other a camera's.
        mean = booked[column].mean()
        share = booked[column] / mean if mean else booked[column]
        axes.plot(booked.frame, share, style, markersize=3, linewidth=1, label=f"{column} / its mean")
    axes.plot(booked.frame[booked.fully_lit], np.zeros(booked.fully_lit.sum()), "k|", label="fully lit")
    for split, color in SPLIT_COLORS.items():
        for i, frame in enumerate(booked.frame[booked.split == split]):
            axes.axvspan(frame - 0.5, frame + 0.5, color=color, alpha=0.2, linewidth=0, label=None if i else split)
    for i, frame in enumerate(booked.frame[booked.suspicious]):
        axes.axvline(frame, color="red", linewidth=2, alpha=0.5, label=None if i else "suspicious")
    axes.set(xlabel="frame", ylabel="brightness", title="Brightness of the subject: LED log against images")
    axes.legend(loc="upper right", ncols=6, fontsize="small")
    axes.set_ylim(bottom=0, top=axes.get_ylim()[1] * 1.15)


def _draw_leds(axes: Axes, booked: pd.DataFrame, patterns: pd.DataFrame, lights: list[str]) -> None:
    row = {light: i for i, light in enumerate(lights)}
    points = axes.scatter(
        patterns.frame, patterns.light.map(row), c=patterns.intensity_r, s=6, marker="s", cmap="viridis", linewidths=0
    )
    axes.figure.colorbar(points, ax=axes, label="intensity", pad=0.01)
    axes.set(
        xlabel="frame", ylabel="LED (row of lights.parquet)", title="Which LED was on when", ylim=(-1, len(lights))
    )


def _draw_offsets(axes: Axes, check: SyncCheck) -> None:
    tried = sorted(check.correlations)
    values = [check.correlations[k] if math.isfinite(check.correlations[k]) else 0.0 for k in tried]
    axes.bar(tried, values, color=["tab:green" if k == check.offset_frames else "tab:gray" for k in tried])
    axes.axhline(0, color="black", linewidth=0.5)
    axes.set(xlabel="offset: images of frame f show the pattern logged for f + offset", ylabel="correlation of changes")
    axes.set_title(f"{check.verdict}: {check.why}")
    axes.set_xticks(tried)
