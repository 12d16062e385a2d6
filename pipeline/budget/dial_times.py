"""Times of dials' settings on a capture, over those of their defaults.

What more steps and finer texels take is told by jobs of that size (`pipeline.budget.run_seconds`), in training and in
all other stages: a capture has no more texels than `most`. What other dials take was measured on other subjects, with
trainings of few steps, of which startup is a good part. So startup is told apart: it is as long whatever a step takes.
It counts as steps, not seconds, as curves of one subject may come from several machines.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.budget.capture_size import CaptureSize
from pipeline.budget.curve import Curve
from pipeline.budget.run_seconds import StageSeconds, expected_texels, run_seconds
from pipeline.config.project import SECTIONS, SubjectSettings
from pipeline.config.sections import merge

TRAINING = "train_avatar"
"""The stage whose time has a startup, and then steps."""

SPENT_IN = {"unwrap_atlas": TRAINING}
"""Where a setting of a stage costs time, if not there: texels are laid out once and trained in every step."""

TEXELS = ("unwrap_atlas", "texel_pixels")
"""The setting whose error is told by how many texels there are."""

STEPS = (TRAINING, "steps")
"""The setting whose curve says what startup takes."""


def spent_in(curve: Curve) -> str:
    """Name the stage in which a dial's time is spent."""
    return SPENT_IN.get(curve.stage, curve.stage)


def told_by_texels(curve: Curve) -> bool:
    """True for the dial whose errors are told by how many texels there are."""
    return (curve.stage, curve.option) == TEXELS


def told_by_size(curve: Curve) -> bool:
    """True for the dials whose times are told by the size of jobs."""
    return (curve.stage, curve.option) in (TEXELS, STEPS)


def texel_ratio(settings: SubjectSettings, size: CaptureSize, curve: Curve, value: Any) -> float:
    """Texels that a capture would have at a setting of their size, over those at the default."""
    asked, usual = (
        expected_texels(with_options(settings, {curve.stage: {curve.option: each}}), size)
        for each in (value, curve.default)
    )
    return asked / usual


@dataclass(frozen=True)
class DialTimes:
    """Times of settings on a capture.

    Attributes:
        settings: of the capture's subject, with all dials at their defaults.
        usual: seconds of each stage at the defaults.
        startup_steps: steps that take as long as the startup of a training.
    """

    settings: SubjectSettings
    size: CaptureSize
    usual: Mapping[str, StageSeconds]
    startup_steps: float

    @classmethod
    def of(cls, settings: SubjectSettings, size: CaptureSize, curves: Sequence[Curve]) -> DialTimes:
        """Times on a capture, with the startup that the curve of steps says.

        It is the median over the subjects: a machine that was slow in a few short runs makes one far too large. Without
        such a curve there is no startup.
        """
        parts = [part for curve in curves if (curve.stage, curve.option) == STEPS for part in curve.parts]
        startup_steps = float(np.median([part.startup_steps() for part in parts])) if parts else 0.0
        return cls(settings, size, run_seconds(settings, size), startup_steps)

    def factor(self, curve: Curve, value: Any) -> float:
        """Time of a stage's work at a setting over that at the default, without startup."""
        if told_by_size(curve):
            stage = spent_in(curve)
            usual = self.usual[stage].work
            return self._at(curve, value)[stage].work / usual if usual > 0 else 1.0
        return curve.factor(value, self.startup_steps if spent_in(curve) == TRAINING else 0.0)

    def elsewhere(self, curve: Curve, value: Any) -> dict[str, float]:
        """Seconds that startup, and stages other than the dial's own, take more than at its default."""
        if not told_by_size(curve):
            return {}
        more = {}
        for stage, found in self._at(curve, value).items():
            more[stage] = found.fixed - self.usual[stage].fixed
            if stage != spent_in(curve):
                more[stage] += found.work - self.usual[stage].work
        return more

    def _at(self, curve: Curve, value: Any) -> dict[str, StageSeconds]:
        """Seconds of each stage at a setting."""
        return run_seconds(with_options(self.settings, {curve.stage: {curve.option: value}}), self.size)


def with_options(settings: SubjectSettings, changes: Mapping[str, Mapping[str, Any]]) -> SubjectSettings:
    """The settings with some options of stages changed."""
    sections = {
        stage: SECTIONS[stage](**merge(getattr(settings, stage).model_dump(), options))
        for stage, options in changes.items()
    }
    return settings.model_copy(update=sections)
