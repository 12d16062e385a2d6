"""Curve of error against time of one dial on one subject."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import yaml

LEAST_SECONDS = 0.01
"""Work that takes less than its import's own scatter counts as this, so that ratios stay finite."""

LAID_OUT = 0.05
"""Share by which texels of an atlas differ from what their size says, once laid out: bodies had 3 % more of
0.9 of a pixel than the square of it says of those of 0.6."""

LARGEST_SHARE = 0.9
"""Of seconds that may count as startup: where short runs were slow for another reason, ratios stay positive."""


@dataclass(frozen=True)
class SubjectCurve:
    """Error and time of one dial's settings on one subject, by the metric that decides.

    Attributes:
        subject: its name.
        metric: what the error is, with its unit and what it is relative to.
        settings: as the table names them.
        errors, scatters, seconds: of each; scatters are standard errors, NaN where they are not known; seconds are with
            the import of the stage.
        imports: seconds that the import alone takes.
        allowed: the error up to which a setting is good enough.
        counts: what the stage counts at each, texels for instance; NaN where it is not known.
    """

    subject: str
    metric: str
    settings: tuple[str, ...]
    errors: tuple[float, ...]
    scatters: tuple[float, ...]
    seconds: tuple[float, ...]
    imports: float
    allowed: float
    counts: tuple[float, ...]

    def startup_steps(self) -> float:
        """Steps that take as long as the work before the first one, of a curve of steps.

        By the line of least relative error through the times: where it meets 0 steps, and no less than nothing, over
        its slope.
        """
        known, seconds = self._numbers(), self._work_seconds()
        if len(known) < 2:
            return 0.0
        numbers, times = np.array(list(known)), seconds[list(known.values())]
        of_a_step, start = np.polyfit(numbers, times, 1, w=1 / times)
        return float(max(start, 0.0) / max(of_a_step, LEAST_SECONDS / numbers.max()))

    def relative(self, value: Any, default: Any, startup_steps: float = 0.0) -> float:
        """Time of work at a setting over that at another, without startup.

        That takes as long as `startup_steps` steps at the other. Where the stage counts none, nothing is left out.
        """
        work, usual = self.work(value), self.work(default)
        steps = self._count(default)
        startup = 0.0 if math.isnan(steps) else usual * startup_steps / (startup_steps + steps)
        return _without(work, startup) / _without(usual, startup)

    def _count(self, value: Any) -> float:
        """What the stage counts at a setting; NaN if it is not known."""
        name = setting_name(value)
        return self.counts[self.settings.index(name)] if name in self.settings else math.nan

    def error_of_count(self, ratio: float, default: Any) -> float:
        """Error where the stage counts so many times as much as at the default: texels of a surface.

        It is that of a setting with as many but for `LAID_OUT`; else in proportion to the side of a texel between what
        was measured, and on beyond the largest. Finer ones than those measured gain nothing more. NaN if counts are
        not known.
        """
        ratios = self._count_ratios(default)
        if ratios is None:
            return math.nan
        apart = np.abs(np.log(ratios / ratio))
        if apart.min() <= LAID_OUT:
            return self.errors[int(apart.argmin())]
        sides, places = np.unique(ratios**-0.5, return_index=True)
        return _on_line(max(ratio**-0.5, float(sides[0])), sides, np.array(self.errors)[places])

    def _count_ratios(self, default: Any) -> np.ndarray | None:
        """What the stage counts at each setting, over that at the default; None if it is not known."""
        usual = self._count(default)
        if math.isnan(usual) or not np.isfinite(self.counts).all():
            return None
        return np.array(self.counts) / usual

    def _work_seconds(self) -> np.ndarray:
        return np.maximum(np.array(self.seconds) - self.imports, LEAST_SECONDS)

    def work(self, value: Any) -> float:
        """Seconds beyond the import at a setting.

        They are in proportion between two numbers, and on beyond the last ones.

        Of what was not measured and is no number, the median of all.
        """
        seconds = self._work_seconds()
        if setting_name(value) in self.settings:
            return float(seconds[self.settings.index(setting_name(value))])
        known, place = self._numbers(), _number(value)
        if place is None or len(known) < 2:
            return float(np.median(seconds))
        x, y = np.array(sorted(known)), np.array([seconds[known[number]] for number in sorted(known)])
        return max(_on_line(place, x, y), LEAST_SECONDS)

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


def parse_setting(name: str) -> Any:
    """A setting from its name in the table, as configuration files have it."""
    return None if name == "all" else yaml.safe_load(name)


def setting_name(value: Any) -> str:
    """A setting's name in the table."""
    return "all" if value is None else str(value)


def _without(seconds: float, startup: float) -> float:
    """Seconds without those of startup, which are no more than nine tenths of them."""
    return seconds - min(startup, LARGEST_SHARE * seconds)


def _on_line(place: float, x: np.ndarray, y: np.ndarray) -> float:
    """Value of a piecewise linear function, which goes on as it went last; a constant of one point."""
    if len(x) < 2 or x[0] <= place <= x[-1]:
        return float(np.interp(place, x, y))
    ends = (0, 1) if place < x[0] else (-2, -1)
    slope = (y[ends[1]] - y[ends[0]]) / (x[ends[1]] - x[ends[0]])
    return float(y[ends[0]] + slope * (place - x[ends[0]]))


def _number(value: Any) -> float | None:
    """A setting as a number, if it is one, also as text."""
    if isinstance(value, bool):
        return None
    try:
        return float(value)
    except (TypeError, ValueError):
        return None
