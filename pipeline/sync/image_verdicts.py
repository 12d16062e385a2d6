"""Verdicts on the images of a capture: exposures, transfer function, surveyed lights."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from pipeline.base.errors import listed
from pipeline.base.verdicts import Grade, Verdict
from pipeline.sync.brightness import BrightnessModel
from pipeline.sync.gain_changes import GainChange, find_gain_changes
from pipeline.sync.log_alternatives import Rig, survey_verdict, transfer_verdict
from pipeline.sync.stored_levels import level_flaws
from pipeline.sync.sync import UNEXPLAINED, SyncCheck

LEAST_FRAMES = 4
"""Frames below which nothing is said about changes: their errors leave no degree of freedom."""


def image_verdicts(
    model: BrightnessModel, check: SyncCheck, means: pd.DataFrame, cameras: Sequence[str], rig: Rig, sigmas: float
) -> list[Verdict]:
    """Judge the exposures of each camera and of all, the transfer function and the survey.

    Changes, transfer function and survey are judged only if the log explains the images at all.

    Args:
        means: of `measure_brightness`.
        cameras: names of the model's.
        sigmas: confidence from which on something counts as found.
    """
    told = check.verdict != UNEXPLAINED and check.patterns.kept.sum() >= LEAST_FRAMES
    changes = find_gain_changes(model, check.patterns) if told else []
    verdicts = exposure_verdicts(means, cameras, changes)
    if told:
        verdicts.append(transfer_verdict(model, check.patterns, sigmas))
        verdicts.append(survey_verdict(model, check.patterns, rig, sigmas))
    return verdicts


def exposure_verdicts(means: pd.DataFrame, cameras: Sequence[str], changes: Sequence[GainChange]) -> list[Verdict]:
    """Judge each camera's exposures, and those of all cameras together.

    By stored levels and by changes. Failed where a lasting change is a stop or more: that is another exposure.
    """
    verdicts = []
    for name, images in means.groupby("camera"):
        own = [change for change in changes if change.camera is not None and cameras[change.camera] == name]
        verdicts.append(_exposure(str(name), [*level_flaws(images), *_changed(own)]))
    common = [change for change in changes if change.camera is None]
    return [*verdicts, _exposure("all", _changed(common))]


def _changed(changes: Sequence[GainChange]) -> list[tuple[Grade, str]]:
    if not changes:
        return []
    stop = any(change.lasting and not 0.5 < change.factor < 2 for change in changes)
    found = listed([str(change) for change in changes])
    return [("failed" if stop else "weak", f"{found}: was the exposure changed, or the power of the lights?")]


def _exposure(name: str, flaws: list[tuple[Grade, str]]) -> Verdict:
    grade: Grade = min((grade for grade, _ in flaws), key=("failed", "weak").index, default="good")
    sound = "steady" if name == "all" else "neither clipped nor coarse, steady"
    return Verdict("exposure", name, grade, "; ".join(text for _, text in flaws) or sound)
