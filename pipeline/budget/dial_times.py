"""Times of dials' settings on a capture, over those of their defaults.

The curves were measured on other subjects, with trainings of a few steps. So of training, what is not steps is told
apart: it is as long however many there are, and whatever a step takes. And what the size of texels takes is told by how
many this capture would have of them, as it has no more than `most`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.budget.capture_size import CaptureSize
from pipeline.budget.curve import Curve
from pipeline.budget.run_seconds import StageSeconds, expected_texels
from pipeline.config.project import SECTIONS, SubjectSettings
from pipeline.config.sections import merge

STEPS = ("train_avatar", "steps")
"""The setting that says how often a stage does the same."""

SPENT_IN = {"unwrap_atlas": "train_avatar"}
"""Where a setting of a stage costs time, if not there: texels are laid out once and trained in every step."""

TOLD_BY_TEXELS = ("unwrap_atlas", "texel_pixels")
"""The setting whose time is told by how many texels there are."""


def spent_in(curve: Curve) -> str:
    """Name the stage in which a dial's time is spent."""
    return SPENT_IN.get(curve.stage, curve.stage)


@dataclass(frozen=True)
class DialTimes:
    """Times of settings on a capture.

    Attributes:
        settings: of the capture's subject.
        share: of the time of training at the defaults, that beside its steps.
        besides: of each subject of the curves, as many seconds.
    """

    settings: SubjectSettings
    size: CaptureSize
    share: float
    besides: Mapping[str, float]

    @classmethod
    def of(cls, settings: SubjectSettings, size: CaptureSize, curves: Sequence[Curve]) -> DialTimes:
        """Times on a capture, with what the curve of steps says of training.

        The share is the median over the subjects: a machine that was slow in a few short runs makes one far too large.
        Without such a curve, nothing is beside steps.
        """
        steps = next((curve for curve in curves if (curve.stage, curve.option) == STEPS), None)
        if steps is None:
            return cls(settings, size, 0.0, {})
        whole = {part.subject: part.work(steps.default) for part in steps.parts}
        share = float(np.median([part.besides() / whole[part.subject] for part in steps.parts]))
        return cls(settings, size, share, {name: share * seconds for name, seconds in whole.items()})

    def split(self, stage: str, seconds: StageSeconds) -> StageSeconds:
        """Seconds of a stage at the defaults, with what no dial changes in its fixed part."""
        if stage != STEPS[0]:
            return seconds
        return StageSeconds(seconds.fixed + self.share * seconds.work, (1 - self.share) * seconds.work)

    def factor(self, curve: Curve, value: Any) -> float:
        """Time of a setting over that of the default, of what dials change."""
        besides = self.besides if spent_in(curve) == STEPS[0] else {}
        if (curve.stage, curve.option) == TOLD_BY_TEXELS:
            texels = [
                expected_texels(with_options(self.settings, {curve.stage: {curve.option: each}}), self.size)
                for each in (value, curve.default)
            ]
            found = curve.factor_of_count(texels[0] / texels[1], besides)
            if np.isfinite(found):
                return found
        return curve.factor(value, besides)


def with_options(settings: SubjectSettings, changes: Mapping[str, Mapping[str, Any]]) -> SubjectSettings:
    """The settings with some options of stages changed."""
    sections = {
        stage: SECTIONS[stage](**merge(getattr(settings, stage).model_dump(), options))
        for stage, options in changes.items()
    }
    return settings.model_copy(update=sections)
