"""Accuracy against time: order and statistics of runs, Pareto front, cheapest setting."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float64

Item = TypeVar("Item")

COLUMNS = [
    "dial", "setting", "metric", "error", "standard_error", "seconds", "seconds_spread", "peak_mb", "work", "unit",
    "seconds_low", "seconds_high", "cpu_seconds", "allowed", "pareto", "chosen", "stage", "option",
]  # fmt: skip
"""Of the table: see `cost_table`."""

IMPORTS_ONLY = "imports only"
"""The setting that stands for starting a stage and doing nothing: the share of the seconds that no dial changes."""


@dataclass
class Cost:
    """Cost of one setting of a dial in all its runs, and the errors of its output.

    Attributes:
        dial, setting: their names.
        tolerances: per metric, in order of importance, the error that nobody minds, in the metric's unit.
        unit: of `work`.
        stage, option: the dial is this option of this stage's settings.
        work: done in one run: corners, rays, ...
        seconds, cpu_seconds, peak_mb: of every run; a setting that was refused has them, too.
        errors: per metric, of every run; none for a setting that was refused or does nothing.
        scatters: per metric, standard errors of these over frames; none where an error is no mean over frames.
    """

    dial: str
    setting: str
    tolerances: dict[str, float]
    unit: str
    stage: str = ""
    option: str = ""
    work: float | int = np.nan
    seconds: list[float] = field(default_factory=list)
    cpu_seconds: list[float] = field(default_factory=list)
    peak_mb: list[float] = field(default_factory=list)
    errors: dict[str, list[float]] = field(default_factory=dict)
    scatters: dict[str, list[float]] = field(default_factory=dict)

    def standard_error(self, metric: str) -> float:
        """Of the mean error: over frames, and over runs if they draw; NaN if neither is known.

        The frames are the same in all runs, so that their part does not become less by more of them.
        """
        errors = np.array(self.errors.get(metric, []), np.float64)
        frames = float(np.mean(np.square(self.scatters.get(metric, [np.nan]))))
        if len(errors) < 2:
            return float(np.sqrt(frames))
        known = frames if np.isfinite(frames) else 0.0  # of images of one frame nobody knows it
        return float(np.sqrt(known + errors.var(ddof=1) / len(errors)))


def interleaved(items: Sequence[Item], repeats: Sequence[int]) -> Iterator[Item]:
    """Repeat items in turn, A B C A B C ...

    Whatever else slows the machine for a while slows all items, not the repeats of one.

    `repeats` says for every item how often it comes; it is left out of the last rounds if others come more often.
    """
    for turn in range(max(repeats, default=0)):
        yield from (item for item, times in zip(items, repeats, strict=True) if turn < times)


def cost_table(costs: Sequence[Cost], relative_tolerance: float) -> pd.DataFrame:
    """One row per dial, setting and metric.

    seconds is the median over the runs, seconds_low and seconds_high their quartiles, seconds_spread the distance of
    the two (interquartile range); cpu_seconds is a median, error the mean, standard_error its own (see
    `Cost.standard_error`), peak_mb the largest of all runs. Per dial and metric: allowed is the error up to which a
    setting is good enough (see `largest_allowed`), pareto says that no other setting is as fast and as accurate, chosen
    that this is the cheapest good enough (see `cheapest_within`). A setting that the stage refused, and `IMPORTS_ONLY`,
    have no error.
    """
    rows = []
    for cost in costs:
        low, middle, high = np.percentile(cost.seconds, [25, 50, 75])
        shared = {
            "dial": cost.dial, "setting": cost.setting, "seconds": middle, "seconds_spread": high - low,
            "seconds_low": low, "seconds_high": high, "cpu_seconds": np.median(cost.cpu_seconds),
            "peak_mb": max(cost.peak_mb), "work": cost.work, "unit": cost.unit, "pareto": False, "chosen": False,
            "stage": cost.stage, "option": cost.option,
        }  # fmt: skip
        for metric, tolerance in cost.tolerances.items():
            error = float(np.mean(cost.errors[metric])) if metric in cost.errors else np.nan
            known = {"metric": metric, "error": error, "standard_error": cost.standard_error(metric)}
            rows.append({**shared, **known, "allowed": tolerance})
    table = pd.DataFrame(rows, columns=COLUMNS)
    for _, group in table.groupby(["dial", "metric"], sort=False):
        seconds, low, high, error = (
            group[name].to_numpy(np.float64) for name in ("seconds", "seconds_low", "seconds_high", "error")
        )
        allowed = largest_allowed(error, relative_tolerance, float(group.allowed.iloc[0]))
        best = cheapest_within(seconds, low, high, error, allowed)
        table.loc[group.index, "pareto"] = pareto_front(seconds, error)
        table.loc[group.index, "allowed"] = allowed
        if best is not None:
            table.loc[group.index[best], "chosen"] = True
    return table


def pareto_front(
    seconds: Float64[np.ndarray, " settings"], error: Float64[np.ndarray, " settings"]
) -> Bool[np.ndarray, " settings"]:
    """Mark the settings on the Pareto front of seconds and error.

    No other setting is at least equal to them in both and better in one; an error of NaN is never among them.
    """
    as_good = (seconds[:, None] <= seconds) & (error[:, None] <= error)
    better = (seconds[:, None] < seconds) | (error[:, None] < error)
    return ~(as_good & better).any(0) & np.isfinite(error)


def largest_allowed(error: Float64[np.ndarray, " settings"], relative: float, absolute: float) -> float:
    """The smallest error and a share `relative` on top, or `absolute` if that is more.

    An output that was compared with itself has an error of 0, which says nothing: then the absolute tolerance counts.
    """
    known = error[np.isfinite(error)]
    return max(absolute, (1 + relative) * float(known.min())) if len(known) else absolute


def cheapest_within(
    seconds: Float64[np.ndarray, " settings"],
    seconds_low: Float64[np.ndarray, " settings"],
    seconds_high: Float64[np.ndarray, " settings"],
    error: Float64[np.ndarray, " settings"],
    limit: float,
) -> int | None:
    """Index of the fastest setting whose error is at most `limit`; None if there is none.

    Settings whose quartiles overlap those of the fastest are as fast as far as anyone can tell: of these the most
    accurate is taken, so that noise does not choose.
    """
    allowed = np.flatnonzero(error <= limit)
    if len(allowed) == 0:
        return None
    fastest = allowed[np.argmin(seconds[allowed])]
    as_fast = allowed[seconds_low[allowed] <= seconds_high[fastest]]
    order = np.lexsort((seconds[as_fast], error[as_fast]))
    return int(as_fast[order[0]])
