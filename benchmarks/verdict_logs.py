"""Sound and broken charts and logs, for the verdicts on colour and on the log of patterns."""

from __future__ import annotations

from functools import cache

import numpy as np

from benchmarks.verdict import Judged
from pipeline.calibration.color.color_chart import Patches
from pipeline.calibration.color.color_response import fit_response
from pipeline.calibration.color.color_verdicts import light_flaws, patch_flaws, response_flaws
from pipeline.config.calibrate_color import CalibrateColor
from pipeline.sync.sync import check_sync
from tests.support.drawings.chart import VALUES
from tests.support.rigs.light_stage import INTERLEAVINGS, Stage, brightness_model, build_stage, photograph

CURVE, CHART, TINT, BURNT = "sRGB taken for linear", "values of another chart", "red lamp on one chart", "overexposed"


def color_alarm(fault: str | None, seed: int, size: float = 2.2) -> bool:
    """Charts of four cameras that differ by 3 %, patches good to 0.1 % of white; cam0 is the one that is broken.

    Red of a lamp is `size` times as strong, and an exponent forgotten is that.
    """
    rng, settings, flawed, responses = np.random.default_rng(seed), CalibrateColor(), {}, {}
    order = rng.permutation(len(VALUES)) if fault == CHART else np.arange(len(VALUES))
    for name in (f"cam{c}" for c in range(4)):
        light = np.array([size, 1.0, 1.0]) if fault == TINT and name == "cam0" else np.ones(3)
        matrix = rng.uniform(0.7, 0.9) * np.eye(3) + rng.normal(0, 0.02, (3, 3))
        color = (VALUES * light) @ matrix.T + rng.normal(0, 0.001, VALUES.shape)
        used = np.ones(len(color), bool)
        if fault == CURVE and name == "cam0":
            color = np.clip(color, 0, 1) ** (1 / size)
        if fault == BURNT and name == "cam0":
            used = (5 * color < 0.99).all(1)
        squares = np.stack([np.tile(divmod(k, 6)[::-1], (4, 1)).astype(float) for k in range(len(color))])
        patches = Patches(color, used, squares)
        flaws = patch_flaws(patches, 0.0, settings)
        if not flaws:
            responses[name] = fit_response(patches, VALUES[order])
            flaws = response_flaws(responses[name], settings)
        flawed[name] = bool(flaws)
    for name, flaws in light_flaws(responses, settings).items():
        flawed[name] |= bool(flaws)
    return any(flawed.values()) if fault is None else flawed["cam0"]


OFFSET, DARK, SWAP = "log one frame off", "LED dead in the log of all", "pattern of one frame exchanged"
CLEAR = ("random groups", "one at a time", "dark frames", "environments")
"""Interleavings that tell one offset from another; the others are rightly undetermined."""


@cache
def stage(number: int) -> Stage:
    """A stage of six cameras and twenty lights around a figure, its light traced."""
    return build_stage(number, frames=30, cameras=6, lights=20)


def log_alarm(fault: str | None, seed: int, size: float = 0.5) -> bool:
    """Brightness of a traced figure under logged patterns.

    The pattern that a frame shows instead differs by `size` of all light of the brightest frame, or more.
    """
    rng, here = np.random.default_rng(seed), stage(seed % 5)
    log = INTERLEAVINGS[CLEAR[seed % len(CLEAR)]](here, rng)
    shown = log.copy()
    if fault == DARK:
        shown[:, int(log.sum((0, 2)).argmax())] = 0
    if fault == SWAP:
        apart = np.abs(log[:, None] - log).sum((2, 3))  # of every two frames' patterns
        pairs = np.argwhere(apart > size * log.sum((1, 2)).max())
        if size < 0.5:  # the least that are as far apart, one per frame on average
            pairs = pairs[np.argsort(apart[*pairs.T], kind="stable")[: len(log)]]
        frame, other = pairs[rng.integers(len(pairs))]
        shown[frame] = log[other]
    numbers = np.arange(len(log)) + (fault == OFFSET)
    check = check_sync(brightness_model(here, log, photograph(here, shown, rng), numbers=numbers))
    lights = any(light.grade == "failed" for light in check.lights)
    return check.timing.grade != "good" or lights


COLOR = Judged("color_verdicts.response_flaws, light_flaws", (CURVE, CHART, TINT, BURNT), color_alarm)
LOG = Judged("sync.check_sync", (OFFSET, DARK, SWAP), log_alarm)
