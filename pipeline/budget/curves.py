"""Committed curves of error against time, from which presets and budgets choose settings.

`config/curves/accuracy_cost.csv` has the rows of a subject's table of that name for the dials that are to be chosen,
`config/curves/subject.yaml` what that subject was like and what its stages took. Written by `pipeline.dials.curves`.
Seconds are those of a processor: on a busy machine they hardly change, and on several cores a run takes less.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from pipeline.base.errors import InputError
from pipeline.config.project import SECTIONS
from pipeline.metrics.cost import IMPORTS_ONLY, cheapest_within, pareto_front

FOLDER = Path("config/curves")
COLUMNS = ["dial", "stage", "option", "setting", "metric", "error", "seconds", "allowed"]


@dataclass(frozen=True)
class Curve:
    """Error and time of one dial's settings, by the metric that decides.

    Attributes:
        dial: its name.
        stage, option: it is this option of this stage's settings.
        metric: what the error is, with its unit and what it is relative to.
        settings: as the table names them.
        errors, seconds: of each; seconds with the import of the stage.
        imports: seconds that the import alone takes.
        allowed: the error up to which a setting is good enough.
    """

    dial: str
    stage: str
    option: str
    metric: str
    settings: tuple[str, ...]
    errors: tuple[float, ...]
    seconds: tuple[float, ...]
    imports: float
    allowed: float

    def front(self) -> list[int]:
        """Settings on the Pareto front, fastest first."""
        kept = np.flatnonzero(pareto_front(np.array(self.seconds), np.array(self.errors)))
        return sorted(kept.tolist(), key=lambda place: (self.seconds[place], self.errors[place]))

    def cheapest(self, limit: float) -> int | None:
        """The fastest setting with an error of at most `limit`; of several the most accurate."""
        seconds = np.array(self.seconds)
        return cheapest_within(seconds, seconds / (1 + TIED), seconds, np.array(self.errors), limit)

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

    def _numbers(self) -> dict[float, int]:
        numbers = {_number(yaml.safe_load(name)): place for place, name in enumerate(self.settings)}
        return {number: place for number, place in numbers.items() if number is not None}


TIED = 0.05
"""Settings that take this share longer are as fast: the seconds of equal runs differ by as much."""

LEAST_SECONDS = 0.01
"""Work that takes less than its import's own scatter counts as this, so that ratios stay finite."""


@dataclass(frozen=True)
class Measured:
    """The subject that the curves were measured on.

    Attributes:
        subject: its name.
        cameras, frames, pixels: cameras, frames, and pixels of an image.
        psnr_db: of its partially lit test images, with its own settings.
        settings: of each dial's option in that run.
        seconds: of each stage in that run, on a processor, with its import.
    """

    subject: str
    cameras: int
    frames: int
    pixels: int
    psnr_db: float
    settings: Mapping[str, Any]
    seconds: Mapping[str, float]


def read_curves(path: Path) -> list[Curve]:
    """The curves of a table of accuracy and cost, in its order; by each dial's first metric.

    Raises:
        InputError: if it is no such table, naming every dial and column that is amiss.
    """
    try:
        table = pd.read_csv(path, dtype={"setting": str})
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: expected the table of the curves, found: {error}; run `make curves`") from error
    if lacking := [name for name in COLUMNS if name not in table]:
        found = ", ".join(table.columns)
        raise InputError(f"{path}: expected the column {lacking[0]}, found {found}; run `make curves`")
    return [_read_curve(path, str(dial), rows) for dial, rows in table.groupby("dial", sort=False)]


def _read_curve(path: Path, dial: str, rows: pd.DataFrame) -> Curve:
    rows = rows[rows.metric == rows.metric.iloc[0]]
    first, known = rows.iloc[0], rows[np.isfinite(rows.error) & (rows.setting != IMPORTS_ONLY)]
    stage, option = str(first.stage), str(first.option)
    if stage not in SECTIONS or option not in SECTIONS[stage].model_fields:
        raise InputError(f"{path}: {dial}: expected a setting of a stage, found {stage}.{option}; run `make curves`")
    imports = rows.seconds[rows.setting == IMPORTS_ONLY]
    if known.empty or imports.empty or not (known.seconds > 0).all() or not first.allowed >= 0:
        raise InputError(f"{path}: {dial}: expected settings with errors and seconds, and {IMPORTS_ONLY}; found none")
    return Curve(
        dial, stage, option, str(first.metric), tuple(known.setting), tuple(known.error), tuple(known.seconds),
        float(imports.iloc[0]), float(first.allowed),
    )  # fmt: skip


def read_measured(path: Path) -> Measured:
    """Read the facts of the curves' subject.

    Raises:
        InputError: if the file does not say what it should.
    """
    try:
        return Measured(**yaml.safe_load(path.read_text()))
    except (OSError, TypeError, yaml.YAMLError) as error:
        raise InputError(f"{path}: expected facts of the curves' subject, found: {error}; run `make curves`") from error


def parse_setting(name: str) -> Any:
    """A setting from its name in the table, as configuration files have it."""
    return None if name == "all" else yaml.safe_load(name)


def setting_name(value: Any) -> str:
    """A setting's name in the table."""
    return "all" if value is None else str(value)


def _number(value: Any) -> float | None:
    """A setting as a number, if it is one, also as text."""
    if isinstance(value, bool):
        return None
    try:
        return float(value)
    except (TypeError, ValueError):
        return None
