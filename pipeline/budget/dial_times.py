"""Times of dials' settings on a capture, over those of their defaults.

The curves were measured on other subjects, with trainings of 200 steps, of which startup is a good part. So startup is
told apart: it is as long however many steps there are, and whatever a step takes. And what the size of texels takes is
told by how many this capture would have of them, as it has no more than `most`; so is what all other stages take, which
have no curve for them.
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

TOLD_BY_TEXELS = ("unwrap_atlas", "texel_pixels")
"""The setting whose time and error are told by how many texels there are."""


def spent_in(curve: Curve) -> str:
    """Name the stage in which a dial's time is spent."""
    return SPENT_IN.get(curve.stage, curve.stage)


def told_by_texels(curve: Curve) -> bool:
    """True for the dial that is told by how many texels there are."""
    return (curve.stage, curve.option) == TOLD_BY_TEXELS


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
        share: of startup, in the time of training at the defaults.
        startup: of each subject of the curves, in seconds.
    """

    settings: SubjectSettings
    size: CaptureSize
    share: float
    startup: Mapping[str, float]

    @classmethod
    def of(cls, settings: SubjectSettings, size: CaptureSize, curves: Sequence[Curve]) -> DialTimes:
        """Times on a capture, with the share of startup that the curve of steps says.

        It is the median over the subjects: a machine that was slow in a few short runs makes one far too large. Without
        such a curve there is no startup.
        """
        steps = next((curve for curve in curves if (curve.stage, curve.option) == (TRAINING, "steps")), None)
        if steps is None:
            return cls(settings, size, 0.0, {})
        whole = {part.subject: part.work(steps.default) for part in steps.parts}
        share = float(np.median([part.startup() / whole[part.subject] for part in steps.parts]))
        return cls(settings, size, share, {name: share * seconds for name, seconds in whole.items()})

    def split(self, stage: str, seconds: StageSeconds) -> StageSeconds:
        """Seconds of a stage at the defaults, with startup in the fixed part, which no dial changes."""
        if stage != TRAINING:
            return seconds
        return StageSeconds(seconds.fixed + self.share * seconds.work, (1 - self.share) * seconds.work)

    def factor(self, curve: Curve, value: Any) -> float:
        """Time of a setting over that of the default, without startup."""
        startup = self.startup if spent_in(curve) == TRAINING else {}
        if told_by_texels(curve):
            found = curve.factor_of_count(texel_ratio(self.settings, self.size, curve, value), startup)
            if np.isfinite(found):
                return found
        return curve.factor(value, startup)

    def elsewhere(self, curve: Curve, value: Any) -> dict[str, float]:
        """Seconds that stages other than the dial's own take more than at its default."""
        if not told_by_texels(curve):
            return {}
        found, usual = (
            run_seconds(with_options(self.settings, {curve.stage: {curve.option: each}}), self.size)
            for each in (value, curve.default)
        )
        return {stage: found[stage].work - usual[stage].work for stage in usual if stage != spent_in(curve)}


def with_options(settings: SubjectSettings, changes: Mapping[str, Mapping[str, Any]]) -> SubjectSettings:
    """The settings with some options of stages changed."""
    sections = {
        stage: SECTIONS[stage](**merge(getattr(settings, stage).model_dump(), options))
        for stage, options in changes.items()
    }
    return settings.model_copy(update=sections)
