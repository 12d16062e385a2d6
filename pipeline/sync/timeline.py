"""Timeline picture of a capture's lighting: brightness seen and predicted, LEDs, verdict."""

from __future__ import annotations

import textwrap
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pipeline.base.files import written_whole
from pipeline.base.splits import VALIDATION
from pipeline.lighting.frame_lights import CHANNELS
from pipeline.sync.sync import SyncCheck

SPLIT_COLORS = {
    "test_frames": "tab:orange", "test_segments": "tab:purple", "test_patterns": "tab:cyan",
    VALIDATION: "tab:olive",
}  # fmt: skip
GRADE_COLORS = {"good": "tab:green", "weak": "tab:gray", "failed": "red"}
INCHES_PER_FRAME, NARROWEST_INCHES, WIDEST_INCHES = 0.12, 11.0, 40.0
LETTERS_PER_INCH = 11
MOST_LETTERS = 700
DARKEST = -10.0
"""Log-likelihood below that of an unknown pattern at which the picture is darkest: nothing is taken for less likely."""


def draw_timeline(
    path: Path, check: SyncCheck, synced: pd.DataFrame, patterns: pd.DataFrame, lights: list[str]
) -> None:
    """Write a PNG of four rows: brightness per frame, fit of offsets, LED x frame, LED verdicts.

    Args:
        synced: frame, fully_lit, split, suspicious.
        patterns: frame, light, intensities, in the numbering of the images, as synced.
        lights: rows of the LED picture.
    """
    width = float(np.clip(INCHES_PER_FRAME * len(synced), NARROWEST_INCHES, WIDEST_INCHES))
    figure = Figure(figsize=(width, 14), layout="constrained")
    brightness, offsets, leds, found = figure.subplots(4, 1, height_ratios=[4, 2.5, 4, 2])
    verdict = textwrap.shorten(f"{check.verdict}: {check.why}", MOST_LETTERS)
    color = {"good": "black", "weak": "tab:brown", "failed": "red"}[check.timing.grade]
    figure.suptitle(textwrap.fill(verdict, int(width * LETTERS_PER_INCH)), color=color)
    _draw_brightness(brightness, check.frames, synced)
    _draw_offsets(offsets, check)
    _draw_leds(leds, patterns, lights, check)
    _draw_powers(found, lights, check)
    for axes in (offsets, leds):
        axes.sharex(brightness)
    brightness.set_xlim(check.frames.frame.min() - 1, check.frames.frame.max() + 1)
    with written_whole(path) as temporary:
        figure.savefig(temporary, format="png", dpi=100)


def _draw_brightness(axes: Axes, frames: pd.DataFrame, synced: pd.DataFrame) -> None:
    axes.fill_between(
        frames.frame, frames.predicted - 2 * frames.deviation, frames.predicted + 2 * frames.deviation,
        color="tab:blue", alpha=0.25, linewidth=0, label="predicted, 2 sigma",
    )  # fmt: skip
    axes.plot(frames.frame, frames.predicted, "-", color="tab:blue", linewidth=1)
    if not np.allclose(frames.logged, frames.predicted, equal_nan=True):
        axes.plot(frames.frame, frames.logged, ":", color="tab:gray", linewidth=1.5, label="predicted as declared")
    axes.plot(frames.frame, frames.observed, "o", color="black", markersize=4, label="observed")
    full = synced.frame[synced.fully_lit]
    axes.plot(full, np.zeros(len(full)), "k|", label="fully lit")
    for split, color in SPLIT_COLORS.items():
        for i, frame in enumerate(synced.frame[synced.split == split]):
            axes.axvspan(frame - 0.5, frame + 0.5, color=color, alpha=0.15, linewidth=0, label=None if i else split)
    for i, frame in enumerate(frames.frame[frames.suspicious]):
        axes.axvline(frame, color="red", linewidth=2, alpha=0.6, label=None if i else "wrong pattern")
    axes.set(ylabel="irradiance / intensity, 1/m²", title="Brightness of the subject, mean over cameras")
    axes.set_ylim(bottom=0, top=axes.get_ylim()[1] * 1.25)
    axes.legend(loc="upper right", ncols=4, fontsize="small")


def _draw_offsets(axes: Axes, check: SyncCheck) -> None:
    """Draw the fit of every frame at every offset, with the course that was found on top."""
    frames, log_offsets = check.frames.frame.to_numpy(), check.log_offsets
    picture = axes.pcolormesh(
        np.append(frames - 0.5, frames[-1] + 0.5), np.append(log_offsets.tried - 0.5, log_offsets.tried[-1] + 0.5),
        log_offsets.evidence.T / log_offsets.independent, cmap="cividis", vmin=DARKEST,
    )  # fmt: skip
    axes.figure.colorbar(picture, ax=axes, label="log-likelihood", pad=0.01)
    color = "tab:green" if not log_offsets.offsets.any() else "red"
    axes.step(frames, log_offsets.offsets, where="mid", color=color, linewidth=2)
    axes.set(
        ylabel="offset of the log",
        title="How well images of frame f fit the pattern logged for f + offset",
        yticks=log_offsets.tried,
    )


def _draw_leds(axes: Axes, patterns: pd.DataFrame, lights: list[str], check: SyncCheck) -> None:
    row = {light: i for i, light in enumerate(lights)}
    levels = patterns[CHANNELS].to_numpy(np.float64)
    places = {"x": patterns.frame, "y": patterns.light.map(row), "s": 6, "marker": "s", "linewidths": 0}
    if (levels == levels[:, :1]).all():
        points = axes.scatter(**places, c=levels[:, 0], cmap="viridis")
        axes.figure.colorbar(points, ax=axes, label="intensity", pad=0.01)
    else:
        axes.scatter(**places, c=np.sqrt(levels / levels.max()))
        axes.set_facecolor("black")
    for fault in check.faults:
        if fault.name in row and fault.kind in ("dead_light", "stuck_light"):
            axes.axhline(row[fault.name], color="red", linewidth=1)
            axes.annotate(fault.kind.replace("_light", ""), (1, row[fault.name]), xycoords=("axes fraction", "data"),
                          color="red", fontsize="small", va="center")  # fmt: skip
    axes.set(xlabel="frame", ylabel="LED (row of lights.parquet)", title="Booked: which LED was on when")
    axes.set_ylim(-1, len(lights))


def _draw_powers(axes: Axes, lights: list[str], check: SyncCheck) -> None:
    colors = [GRADE_COLORS[verdict.grade] for verdict in check.lights]
    heights = np.minimum(check.powers.dead, check.powers.stuck)
    for fault in check.faults:  # what a fault of a light that is faulty would add says nothing
        if fault.name in lights:
            heights[lights.index(fault.name)] = fault.sigmas
    axes.bar(range(len(lights)), heights, color=colors)
    for grade, color in GRADE_COLORS.items():
        axes.bar([0], [0], color=color, label=f"{sum(v.grade == grade for v in check.lights)} {grade}")
    axes.legend(loc="upper right", ncols=3, fontsize="small")
    axes.set(
        xlabel="LED (row of lights.parquet)", ylabel="sigma", xlim=(-1, len(lights)),
        title="By how much a dead LED, or one that is always on, would show; grey: too little to tell",
    )  # fmt: skip
