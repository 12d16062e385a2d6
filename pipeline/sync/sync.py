"""Verdict on the LED log: whether it is in step with the images and true, with its faults.

Two steps: which offset between log and images each frame has (`offset_viterbi`), and then, with the patterns where they
belong, which LEDs and single frames do not fit (`led_faults`). Confidence is sqrt(2 log-likelihood ratio) throughout:
of a healthy stage it exceeds s with a probability below that of a normal variable exceeding s, 3e-7 for s = 5, whatever
is tested, since the ratio of two simple hypotheses with separation d is distributed as N(-d^2 / 2, d^2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from pipeline.base.errors import listed
from pipeline.base.verdicts import Verdict
from pipeline.sync.brightness import BrightnessModel
from pipeline.sync.led_faults import IndexedFault, Patterns, Powers, find_faults
from pipeline.sync.offset_viterbi import LARGEST_SCALE, LogOffsets, find_log_offsets

IN_SYNC, FAULTY, UNDETERMINED, UNEXPLAINED = "in_sync", "faulty", "undetermined", "unexplained"

AS_LIKELY = 2.0
"""Log-likelihood by which a place where the offset changes may be worse than the best and still be named: 2 sigma."""


@dataclass(frozen=True)
class Fault:
    """One thing that is wrong with the log.

    Attributes:
        kind: offset, missing_image, doubled_image, wrong_pattern, dead_light or stuck_light.
        name: the frame that it starts at (offset and images), the frame, or the light.
        sigmas: confidence, see the module.
        value: the offset from there on; frame whose logged pattern is shown instead (-1: none of them); radiant
            intensity at which the light is stuck, mean of its channels.
        why: a sentence.
    """

    kind: str
    name: str
    sigmas: float
    value: float
    why: str


@dataclass(frozen=True)
class SyncCheck:
    """Findings of comparing log and images.

    Attributes:
        verdict: in_sync; faulty; undetermined, if the patterns do not tell neighbouring frames apart; unexplained, if
            the images have little to do with the log.
        frames: per frame with images: frame, offset_frames, predicted (with the faults in mind), logged (as declared),
            observed, deviation of observed - predicted, suspicious.
        constants: lights found at one level in all frames, 0 if dead: linear RGB.
        sigmas_ahead: by how much the declared timing fits better than each other constant offset.
        lights: one verdict per light.
        powers: by how many sigmas a fault of each light would have shown.
        log_offsets: how well each frame fits each offset.
        patterns: taken to have been on, without the faults.
    """

    verdict: str
    why: str
    faults: list[Fault]
    frames: pd.DataFrame
    constants: dict[str, np.ndarray]
    sigmas_ahead: dict[int, float]
    lights: list[Verdict]
    powers: Powers
    log_offsets: LogOffsets
    patterns: Patterns

    @property
    def timing(self) -> Verdict:
        """The whole check in one line."""
        grade = {IN_SYNC: "good", UNDETERMINED: "weak"}.get(self.verdict, "failed")
        return Verdict("log", self.verdict, grade, self.why)


def check_sync(model: BrightnessModel, max_offset: int = 5, sigmas: float = 5.0) -> SyncCheck:
    """Compare what the log predicts with what the cameras saw.

    Args:
        max_offset: largest offset between log and images tried, frames.
        sigmas: confidence from which on something counts as a fault.
    """
    log_offsets = find_log_offsets(model, max_offset, sigmas)
    rows = model.log.rows_for(model.frames + log_offsets.offsets)
    found, patterns, powers = find_faults(model, Patterns(model.levels[rows], rows >= 0), sigmas)
    faults = [*_timing_faults(model, log_offsets), *(_fault(model, log_offsets, item) for item in found)]
    ahead = {int(k): log_offsets.sigmas(0, int(k)) for k in log_offsets.tried if k != 0}
    verdict, why = _judge(model, log_offsets, patterns, faults, ahead, sigmas)
    constants = {
        model.log.lights[f.index]: f.value * _usual_color(model, f.index)
        for f in found if f.kind in ("dead_light", "stuck_light")
    }  # fmt: skip
    frames, lights = _frame_table(model, log_offsets, patterns, found), _judge_lights(model, faults, powers, sigmas)
    return SyncCheck(verdict, why, faults, frames, constants, ahead, lights, powers, log_offsets, patterns)


def _usual_color(model: BrightnessModel, light: int) -> np.ndarray:
    """Linear RGB of a light as it is usually logged, of level 1 (`BrightnessModel.levels`)."""
    sent = model.log.levels[:, light].sum(0)
    color = sent if sent.any() else np.ones(3)
    return color / max(float(color @ model.channel_weights) / 3, np.finfo(float).tiny)


def _judge(
    model: BrightnessModel,
    log_offsets: LogOffsets,
    patterns: Patterns,
    faults: list[Fault],
    ahead: dict[int, float],
    sigmas: float,
) -> tuple[str, str]:
    chosen = log_offsets.evidence[
        np.arange(len(log_offsets.offsets)), np.searchsorted(log_offsets.tried, log_offsets.offsets)
    ]
    if (chosen <= 0).mean() > 0.5 or log_offsets.scale >= LARGEST_SCALE or patterns.kept.mean() <= 0.5:
        share = f"{(chosen > 0).sum()} of {len(chosen)} frames fit it better than they fit any pattern at all"
        return UNEXPLAINED, f"the images have little to do with the log, at any offset tried: {share}"
    if faults:
        return FAULTY, "; ".join(fault.why for fault in faults)
    close = [k for k, value in ahead.items() if value < sigmas]
    if -1 in close or 1 in close:
        return UNDETERMINED, f"the patterns do not tell apart the offsets 0, {listed([f'{k:+d}' for k in close], 10)}"
    rest = f"; only {listed([f'{k:+d}' for k in close], 10)} would do as well" if close else ""
    least = min(value for k, value in ahead.items() if k not in close)
    return IN_SYNC, f"as declared, {least:.0f} sigma or more ahead of other offsets{rest}"


def _timing_faults(model: BrightnessModel, log_offsets: LogOffsets) -> list[Fault]:
    faults, before = [], 0
    for first, last in log_offsets.runs():
        offset, frame = int(log_offsets.offsets[first]), int(model.frames[first])
        sure = log_offsets.sigmas(offset, before, slice(first, last + 1))
        steps = offset - before
        if first == 0 and offset:
            why = f"images show the patterns logged {offset:+d} frames away ({sure:.0f} sigma)"
            faults.append(Fault("offset", str(frame), sure, float(offset), why))
        elif first:
            kind, what = ("missing_image", "lost") if steps > 0 else ("doubled_image", "stored twice")
            place = " to ".join(dict.fromkeys(str(model.frames[row]) for row in _places(log_offsets, first, last)))
            why = f"{abs(steps)} image{'s' * (abs(steps) > 1)} {what} before frame {place} ({sure:.0f} sigma)"
            faults.append(Fault(kind, str(frame), sure, float(offset), why))
        before = offset
    return faults


def _places(log_offsets: LogOffsets, first: int, last: int) -> tuple[int, int]:
    """First and last row at which the change of offset at row `first` may be as well.

    Equal patterns hide the right one.
    """
    old, new = (np.searchsorted(log_offsets.tried, log_offsets.offsets[row]) for row in (first - 1, first))
    gained = log_offsets.evidence[:, new] - log_offsets.evidence[:, old]
    earlier = later = first
    while earlier > 1 and -gained[earlier - 1 : first].sum() < AS_LIKELY:
        earlier -= 1
    while later < last and gained[first : later + 1].sum() < AS_LIKELY:
        later += 1
    return earlier, later


def _fault(model: BrightnessModel, log_offsets: LogOffsets, found: IndexedFault) -> Fault:
    sure = f"({found.sigmas:.0f} sigma)"
    if found.kind == "wrong_pattern":
        frame = int(model.frames[found.index])
        shown = int(model.log.numbers[int(found.value)]) if found.value >= 0 else -1
        own = frame + int(log_offsets.offsets[found.index])
        instead = f"rather the one logged for {shown}" if shown not in (-1, own) else "nor any other that is logged"
        why = f"frame {frame} does not show its pattern, {instead} {sure}"
        return Fault(found.kind, str(frame), found.sigmas, float(shown), why)
    light = model.log.lights[found.index]
    state = "never lights" if found.kind == "dead_light" else f"is always on, at {found.value:.3g}"
    return Fault(found.kind, light, found.sigmas, found.value, f"light {light} {state} {sure}")


def _judge_lights(model: BrightnessModel, faults: list[Fault], powers: Powers, sigmas: float) -> list[Verdict]:
    """Per light: failed if dead or stuck; weak if that could not have been seen; else good."""
    broken = {fault.name: fault for fault in faults if fault.kind in ("dead_light", "stuck_light")}
    verdicts = []
    for light, dead, stuck in zip(model.log.lights, powers.dead, powers.stuck, strict=True):
        if light in broken:
            hint = "replace it; set book_patterns.on_desync to fix to book it as it was"
            verdicts.append(Verdict("light", light, "failed", f"{broken[light].why}; {hint}"))
            continue
        seen = f"dead would show by {dead:.1f} sigma, always on by {stuck:.1f}"
        if min(dead, stuck) >= sigmas:
            verdicts.append(Verdict("light", light, "good", f"lights as logged: {seen}"))
        else:
            advice = "switch it alone, or with few others, in more frames"
            verdicts.append(Verdict("light", light, "weak", f"{seen}: too little to tell; {advice}"))
    return verdicts


def _frame_table(
    model: BrightnessModel, log_offsets: LogOffsets, patterns: Patterns, found: list[IndexedFault]
) -> pd.DataFrame:
    """Brightness of each frame as the mean over cameras; `deviation` is one sigma of it.

    Each camera is in the units of its prediction.
    """
    predicted = model.predicted(patterns.levels)
    gains = model.gains(predicted, patterns.kept)
    spread = log_offsets.scale * np.sqrt(model.variance(patterns.levels) * model.camera_correlation.mean())
    known = model.log.rows_for(model.frames + log_offsets.offsets) >= 0
    declared = model.log.rows_for(model.frames)
    wrong = [item.index for item in found if item.kind == "wrong_pattern"]
    return pd.DataFrame(
        {
            "frame": model.frames,
            "offset_frames": log_offsets.offsets,
            "predicted": np.where(known, predicted.mean(1), np.nan),
            "logged": np.where(declared >= 0, model.predicted(model.levels[declared]).mean(1), np.nan),
            "observed": (model.observed / gains).mean(1),
            "deviation": spread,
            "suspicious": np.isin(np.arange(len(model.frames)), wrong),
        }
    )
