"""Sound and broken exposures, transfer functions and surveys, for the verdicts on images of a stage.

Brightness is that of a traced figure (`tests/support/rigs/light_stage`), pixels those of a walking one. Sizes of
faults: factors of brightness for exposures, metres or degrees for surveys.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd

from benchmarks.verdict import Judged
from benchmarks.verdict_figures import CAMERAS, FRAMES, cameras, mask
from benchmarks.verdict_logs import CLEAR, stage
from pipeline.sync.gain_changes import GainChange, find_gain_changes
from pipeline.sync.led_faults import Patterns
from pipeline.sync.log_alternatives import Rig, moved_lights, survey_verdict, transfer_verdict
from pipeline.sync.stored_levels import LEVELS, level_flaws, stored_levels
from pipeline.sync.subject_proxy import Ellipsoid
from tests.support.rigs.light_stage import INTERLEAVINGS, Stage, brightness_model, photograph

SIGMAS = 5.0
"""`book_patterns.fault_sigma`."""

STAND_IN = Ellipsoid(np.array([0.0, -0.05, 0.0]), np.diag([0.3, 0.85, 0.25]))
"""As `brightness_model` has it."""


def recorded(seed: int) -> tuple[Stage, np.ndarray, np.ndarray, np.random.Generator]:
    """A stage, its log and its brightness, sound."""
    rng, here = np.random.default_rng(seed), stage(seed % 5)
    log = INTERLEAVINGS[CLEAR[seed % len(CLEAR)]](here, rng)
    return here, log, photograph(here, log, rng), rng


FRAME, IMAGE, CAMERA, ALL = (
    "one frame brighter", "one image brighter", "one camera brighter from a frame on", "all brighter from a frame on",
)  # fmt: skip
STOP = 2.0
"""Factor of the faults that are counted: a stop."""


def gain_alarm(fault: str | None, seed: int, size: float = STOP) -> bool:
    """Changes of brightness; a missed one is that of another camera, or two frames off and more."""
    here, log, seen, rng = recorded(seed)
    frame, camera = int(rng.integers(4, len(seen) - 4)), int(rng.integers(seen.shape[1]))
    part = {FRAME: np.s_[frame], IMAGE: np.s_[frame, camera], CAMERA: np.s_[frame:, camera], ALL: np.s_[frame:]}
    if fault is not None:
        seen[part[fault]] *= size
    found = find_gain_changes(brightness_model(here, log, seen), declared(log))
    common = fault in (FRAME, ALL)
    return bool(found) if fault is None else any(_is(change, None if common else camera, frame) for change in found)


def _is(change: GainChange, camera: int | None, frame: int) -> bool:
    return change.camera == camera and abs(change.frame - frame) < 2


def declared(log: np.ndarray) -> Patterns:
    """All frames, under the logged patterns."""
    return Patterns(log.mean(2), np.ones(len(log), bool))


OVER, UNDER = "overexposed, two stops over white", "underexposed, 8 bit, white at 3 counts"


def level_alarm(fault: str | None, seed: int, size: float | None = None) -> bool:
    """Twelve images of a camera, in 8 or 16 bit or half floats; its exposure is wrong by a factor.

    Radiance of the subject is lognormal with a deviation of half a stop, lit from a side; the brightest of a sound one
    is between half of white and white.
    """
    rng, number = np.random.default_rng(seed), seed % 5
    name = sorted(cameras())[rng.integers(CAMERAS)]
    sound = rng.uniform(0.5, 1)
    top = {OVER: 4.0, UNDER: 3 / 255, None: sound}[fault] if size is None else size
    depth = 255 if fault == UNDER else (255, 65535, None)[seed % 3]
    rows = []
    for frame in range(FRAMES):
        own = mask(number, name, frame) >= 128
        side = np.broadcast_to(np.linspace(0.4, 1.0, own.shape[1]), own.shape)[own]
        light = side * np.exp(rng.normal(0, 0.5 * np.log(2), len(side)))
        light = top * (light / light.max())[:, None] * [1.0, 0.8, 0.7] * rng.uniform(0.9, 1)
        stored = np.minimum(light * (1 + rng.normal(0, 0.01, light.shape)), 1)
        stored = np.float16(stored) if depth is None else np.round(stored * depth) / depth
        pixels = stored.astype(np.float32)
        rows.append((*pixels.mean(0), *stored_levels(pixels)))
    return bool(level_flaws(pd.DataFrame(rows, columns=["r", "g", "b", *LEVELS])))


FORGOTTEN, DOUBLED = "sRGB taken for linear", "linear taken for sRGB"


def transfer_alarm(fault: str | None, seed: int, size: float = 2.2) -> bool:
    """Brightness under another exponent; that no transfer function can be told is no alarm of a sound one."""
    here, log, seen, _ = recorded(seed)
    power = {FORGOTTEN: 1 / size, DOUBLED: size, None: 1.0}[fault]
    model = brightness_model(here, log, np.maximum(seen, 1e-6) ** power)
    return transfer_verdict(model, declared(log), SIGMAS).grade == "failed"


MIRRORED, AXES, FEET, TURNED, SHIFTED, NAMES = (
    "survey mirrored", "y and z exchanged", "survey in feet", "survey turned about y", "survey shifted along x",
    "names of two lights exchanged",
)  # fmt: skip


def survey_alarm(fault: str | None, seed: int, size: float | None = None) -> bool:
    """Lights as a survey has them that is off: turned by 45 degrees, shifted by a metre, or as asked."""
    here, log, seen, _ = recorded(seed)
    turn = np.radians(45 if size is None else size)
    c, s = np.cos(turn), np.sin(turn)
    ways: dict[str | None, Callable[[np.ndarray], np.ndarray]] = {
        None: lambda lights: lights, MIRRORED: lambda lights: lights * [-1, 1, 1],
        AXES: lambda lights: lights[:, [0, 2, 1]], FEET: lambda lights: lights / 0.3048,
        TURNED: lambda lights: lights @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T,
        SHIFTED: lambda lights: lights + np.array([1.0 if size is None else size, 0, 0]),
        NAMES: lambda lights: lights[_exchange(lights, seed)],
    }  # fmt: skip
    rig = Rig(ways[fault](here.lights), here.cameras, STAND_IN)
    model = moved_lights(brightness_model(here, log, seen), rig, rig.lights)
    return survey_verdict(model, declared(log), rig, SIGMAS).grade != "good"


def _exchange(lights: np.ndarray, seed: int) -> np.ndarray:
    """An order of the lights in which two that are more than their distance from the middle apart change places."""
    apart = np.linalg.norm(lights[:, None] - lights, axis=2)
    pairs = np.argwhere(np.triu(apart) > np.median(np.linalg.norm(lights, axis=1)))
    order, pair = np.arange(len(lights)), pairs[np.random.default_rng(seed).integers(len(pairs))]
    order[pair] = pair[::-1]
    return order


GAIN = Judged("gain_changes.find_gain_changes", (FRAME, IMAGE, CAMERA, ALL), gain_alarm)
LEVEL = Judged("stored_levels.level_flaws", (OVER, UNDER), level_alarm)
TRANSFER = Judged("log_alternatives.transfer_verdict", (FORGOTTEN, DOUBLED), transfer_alarm)
SURVEY = Judged("log_alternatives.survey_verdict", (MIRRORED, AXES, FEET, TURNED, SHIFTED, NAMES), survey_alarm)
