"""Curve of error against time of one dial: of a subject, and of several together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import yaml

from pipeline.metrics.cost import cheapest_within, pareto_front

LEAST_SECONDS = 0.01
"""Work that takes less than its import's own scatter counts as this, so that ratios stay finite."""

LEAST_ALLOWED = 1e-12
"""Errors that are allowed to be nothing are compared with this, so that ratios stay finite."""

TIED = 0.05
"""Settings that take this share longer are as fast: the seconds of equal runs differ by as much."""


@dataclass(frozen=True)
class SubjectCurve:
    """Error and time of one dial's settings on one subject, by the metric that decides.

    Attributes:
        subject: its name.
        settings: as the table names them.
        errors, scatters, seconds: of each; scatters are standard errors, NaN where they are not known; seconds are with
            the import of the stage.
        imports: seconds that the import alone takes.
        allowed: the error up to which a setting is good enough.
    """

    subject: str
    settings: tuple[str, ...]
    errors: tuple[float, ...]
    scatters: tuple[float, ...]
    seconds: tuple[float, ...]
    imports: float
    allowed: float

    def work(self, value: Any) -> float:
        """Seconds beyond the import at a setting.

        They are in proportion between two numbers, and on beyond the last ones.

        Of what was not measured and is no number, the median of all.
        """
        seconds = np.maximum(np.array(self.seconds) - self.imports, LEAST_SECONDS)
        if setting_name(value) in self.settings:
            return float(seconds[self.settings.index(setting_name(value))])
        known, place = self._numbers(), _number(value)
        if place is None or len(known) < 2:
            return float(np.median(seconds))
        x, y = np.array(sorted(known)), np.array([seconds[known[number]] for number in sorted(known)])
        if x[0] <= place <= x[-1]:
            return float(np.interp(place, x, y))
        ends = (0, 1) if place < x[0] else (-2, -1)
        slope = (y[ends[1]] - y[ends[0]]) / (x[ends[1]] - x[ends[0]])
        return float(max(y[ends[0]] + slope * (place - x[ends[0]]), LEAST_SECONDS))

    def error(self, value: Any) -> float:
        """Error at a setting, in proportion between two numbers; NaN if nothing near was measured."""
        if setting_name(value) in self.settings:
            return self.errors[self.settings.index(setting_name(value))]
        known, place = self._numbers(), _number(value)
        if place is None or not known or not min(known) <= place <= max(known):
            return float("nan")
        x = sorted(known)
        return float(np.interp(place, x, [self.errors[known[number]] for number in x]))

    def scatter(self, value: Any) -> float:
        """Standard error of the error at a setting; 0 if it is not known."""
        known = self.scatters[self.settings.index(setting_name(value))] if setting_name(value) in self.settings else 0.0
        return 0.0 if math.isnan(known) else known

    def _numbers(self) -> dict[float, int]:
        numbers = {_number(yaml.safe_load(name)): place for place, name in enumerate(self.settings)}
        return {number: place for number, place in numbers.items() if number is not None}


@dataclass(frozen=True)
class Curve:
    """Error and time of one dial's settings, over all subjects that it was measured on.

    Attributes:
        dial: its name.
        stage, option: it is this option of this stage's settings.
        metric: what the error is on the first subject, with its unit and what it is relative to.
        default: what the option is if nobody says anything.
        parts: the curves of the subjects, at least one.
    """

    dial: str
    stage: str
    option: str
    metric: str
    default: Any
    parts: tuple[SubjectCurve, ...]

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

    def losses(self, value: Any) -> list[float]:
        """Error at a setting over what is allowed, on each subject."""
        return [part.error(value) / max(part.allowed, LEAST_ALLOWED) for part in self.parts]

    def factor(self, value: Any) -> float:
        """Time at a setting, without imports, over that at the default: a geometric mean."""
        return _geometric_mean([part.work(value) / part.work(self.default) for part in self.parts])

    def duration(self, value: Any) -> float:
        """Time at a setting with the import of the stage, seconds: a geometric mean."""
        return _geometric_mean([part.imports + part.work(value) for part in self.parts])

    def front(self) -> list[str]:
        """Settings on the Pareto front of time and mean loss, fastest first."""
        values = [parse_setting(name) for name in self.settings]
        factors = np.array([self.factor(value) for value in values])
        losses = np.array([float(np.mean(self.losses(value))) for value in values])
        kept = np.flatnonzero(pareto_front(factors, losses))
        return [self.settings[place] for place in sorted(kept, key=lambda place: (factors[place], losses[place]))]

    def cheapest(self, limit: float) -> str | None:
        """The fastest setting that loses at most `limit` on every subject.

        Of several that are about as fast it is the most accurate.
        """
        values = [parse_setting(name) for name in self.settings]
        seconds = np.array([self.duration(value) for value in values])
        worst = np.array([max(self.losses(value)) for value in values])
        place = cheapest_within(seconds, seconds / (1 + TIED), seconds, worst, limit)
        return None if place is None else self.settings[place]

    def of(self, subject: str) -> SubjectCurve | None:
        """The curve of one subject; None if it was not measured."""
        return next((part for part in self.parts if part.subject == subject), None)


def parse_setting(name: str) -> Any:
    """A setting from its name in the table, as configuration files have it."""
    return None if name == "all" else yaml.safe_load(name)


def setting_name(value: Any) -> str:
    """A setting's name in the table."""
    return "all" if value is None else str(value)


def _geometric_mean(values: Sequence[float]) -> float:
    return float(np.exp(np.mean(np.log(values))))


def _number(value: Any) -> float | None:
    """A setting as a number, if it is one, also as text."""
    if isinstance(value, bool):
        return None
    try:
        return float(value)
    except (TypeError, ValueError):
        return None
