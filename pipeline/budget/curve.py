"""Curve of error against time of one dial, over several subjects together."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pipeline.budget.subject_curve import SubjectCurve, parse_setting
from pipeline.metrics.cost import cheapest_within

LEAST_ALLOWED = 1e-12
"""Errors that are allowed to be nothing are compared with this, so that ratios stay finite."""

TIED = 0.05
"""Settings that take this share longer are as fast: the seconds of equal runs differ by as much."""


@dataclass(frozen=True)
class Curve:
    """Error and time of one dial's settings, over all subjects that it was measured on.

    Attributes:
        dial: its name.
        stage, option: it is this option of this stage's settings.
        default: what the option is if nobody says anything.
        parts: the curves of the subjects, at least one.
    """

    dial: str
    stage: str
    option: str
    default: Any
    parts: tuple[SubjectCurve, ...]

    @property
    def metric(self) -> str:
        """Name of the error, with its unit and what it is relative to.

        Where that differs, it says on which subjects.
        """
        subjects: dict[str, list[str]] = {}
        for part in self.parts:
            subjects.setdefault(part.metric, []).append(part.subject)
        if len(subjects) == 1:
            return self.parts[0].metric
        return "; ".join(f"{metric} on {', '.join(names)}" for metric, names in subjects.items())

    @property
    def settings(self) -> tuple[str, ...]:
        """Settings that were measured on every subject."""
        return tuple(name for name in self.parts[0].settings if all(name in part.settings for part in self.parts))

    @property
    def allowed(self) -> float:
        """The error up to which a setting is good enough: the mean over the subjects."""
        return float(np.mean([part.allowed for part in self.parts]))

    def error(self, value: Any) -> float:
        """Error at a setting, the mean over the subjects; NaN if nothing near was measured."""
        return float(np.mean([part.error(value) for part in self.parts]))

    def error_of_count(self, ratio: float) -> float:
        """Error where the stage counts `ratio` times as much as at the default.

        The mean over the subjects; NaN if nobody counted.
        """
        return float(np.mean([part.error_of_count(ratio, self.default) for part in self.parts]))

    def losses(self, value: Any) -> list[float]:
        """Error at a setting over what is allowed, on each subject."""
        return [part.error(value) / max(part.allowed, LEAST_ALLOWED) for part in self.parts]

    def factor(self, value: Any, startup_steps: float = 0.0) -> float:
        """Time at a setting, without imports, over that at the default: a geometric mean.

        A startup as long as `startup_steps` steps is left out of both.
        """
        return _geometric_mean([part.relative(value, self.default, startup_steps) for part in self.parts])

    def duration(self, value: Any) -> float:
        """Time at a setting with the import of the stage, seconds: a geometric mean."""
        return _geometric_mean([part.imports + part.work(value) for part in self.parts])

    def cheapest(self, limit: float) -> str | None:
        """The fastest setting that loses at most `limit` on every subject.

        Of several that are about as fast it is the most accurate.
        """
        values = [parse_setting(name) for name in self.settings]
        seconds = np.array([self.duration(value) for value in values])
        worst = np.array([max(self.losses(value)) for value in values])
        place = cheapest_within(seconds, seconds / (1 + TIED), seconds, worst, limit)
        return None if place is None else self.settings[place]

    def among(self, subjects: Collection[str]) -> Curve:
        """The curve of some subjects; of all, if it has none of them."""
        parts = tuple(part for part in self.parts if part.subject in subjects)
        return replace(self, parts=parts or self.parts)

    def of(self, subject: str) -> SubjectCurve | None:
        """The curve of one subject; None if it was not measured."""
        return next((part for part in self.parts if part.subject == subject), None)


def _geometric_mean(values: Sequence[float]) -> float:
    return float(np.exp(np.mean(np.log(values))))
