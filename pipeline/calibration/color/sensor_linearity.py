"""Stored value up to which a sensor is linear, from one scene at several exposure times.

Where a pixel is dark enough for any sensor to be linear, its counts over the exposure times are its brightness. That
predicts its counts at longer times, and from some count on they fall short.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Shaped
from numpy.lib.stride_tricks import sliding_window_view

ANCHOR = 0.25
"""Share of full scale up to which counts are taken for linear: wells and amplifiers bend near their ends."""

DIMMEST = 0.02
"""Share of full scale, above black, of the darkest counts that predict others: those of 8 bits, +-0.3, to 6 %."""

BLACK_SHARE = 0.01
"""Of full scale: a black level wrong by as much is half of what a chart's black patch reflects."""

BINS = 40
"""Of full scale, by predicted counts: 6 counts of 8 bits each."""

LEAST_SAMPLES = 50
"""Pixels of a bin below which it says nothing: their median is good to a seventh of a pixel's noise."""

MOST_SAMPLES = 400_000
"""Pixels that are looked at, evenly spread: more change nothing."""

FARTHEST = 1.5
"""Of full scale: what is predicted to be brighter is saturated in any case."""

LEAST_LEVERAGE = 1.5
"""Factor between the shortest and the longest exposure, at least: predictions at nearly the same time say nothing."""


@dataclass(frozen=True)
class Linearity:
    """Response of one sensor, in stored values.

    Attributes:
        full: largest value that can be stored.
        up_to: stored count from which the response departs from a line by more than the tolerance; NaN if it never
            does.
        brightest: largest predicted count that was looked at.
        black_level: count at no exposure, by lines through the dark counts; NaN if no pixel shows it.
        departure: measured over predicted, less 1, at `predicted` counts; the median of three bins.
    """

    full: float
    up_to: float
    brightest: float
    black_level: float
    predicted: Float64[np.ndarray, " bins"]
    departure: Float64[np.ndarray, " bins"]

    def __str__(self) -> str:
        limit = f"linear up to a count of {self.up_to:.4g}"
        if np.isnan(self.up_to):
            limit = f"linear up to {self.brightest:.4g}, the largest count in the series"
        return limit + ("" if np.isnan(self.black_level) else f", black level {self.black_level:.3g}")


def measure_linearity(
    counts: Float64[np.ndarray, "exposures pixels"], seconds: Float64[np.ndarray, " exposures"],
    black_level: float, full: float, tolerance: float,
) -> Linearity | None:  # fmt: skip
    """Find where counts fall short of what shorter exposures predict.

    Args:
        counts: stored values of pixels that see the same light at all exposures; any colours.
        seconds: exposure times, in any order; only their ratios matter.
        black_level: stored value of no light.
        full: largest value that can be stored.
        tolerance: departure from a line that still counts as linear, relative.

    Returns:
        None if too few pixels are dark in one exposure and bright in another.
    """
    order = np.argsort(seconds)
    counts, seconds = looked_at(counts)[order], seconds[order]
    if len(seconds) < 2 or seconds[-1] < LEAST_LEVERAGE * seconds[0]:
        return None
    dark = (counts <= ANCHOR * full) & (counts >= black_level + DIMMEST * full)
    black = _black_level(counts, seconds, dark)
    if abs(black - black_level) > BLACK_SHARE * full:  # Declared wrong: a line through it would bend by itself.
        black_level = black
    signal, times = counts - black_level, np.where(dark, seconds[:, None], 0.0)
    brightness = (signal * times).sum(0) / np.maximum((times**2).sum(0), np.finfo(float).tiny)
    predicted = brightness * seconds[:, None]
    judged = ~dark & (predicted > ANCHOR * full) & (predicted < FARTHEST * full)
    bins = np.floor(predicted[judged] / full * BINS).astype(int)
    ratio, middles, departures = signal[judged] / predicted[judged] - 1, [], []
    for number in range(bins.max(initial=-1) + 1):
        if (bins == number).sum() >= LEAST_SAMPLES:
            middles.append((number + 0.5) / BINS * full + black_level)
            departures.append(float(np.median(ratio[bins == number])))
    if not middles:
        return None
    # A single bin beside two others is noise: a sensor that bends stays bent.
    at = np.array(middles)
    departure = np.median(sliding_window_view(np.pad(departures, 1, mode="edge"), 3), axis=1)
    found, brightest = (1 + departure) * (at - black_level) + black_level, min(float(at[-1]), full)
    limit = _first_beyond(found, departure, tolerance)
    return Linearity(full, limit, brightest, black, at, departure)


def looked_at(counts: Shaped[np.ndarray, "*exposures pixels"]) -> Shaped[np.ndarray, "*exposures some"]:
    """Counts of at most `MOST_SAMPLES` pixels, evenly spread; of so few, all."""
    return counts[..., :: max(1, -(-counts.shape[-1] // MOST_SAMPLES))]


def _first_beyond(at: np.ndarray, departure: np.ndarray, tolerance: float) -> float:
    """Count at which the departure crosses the tolerance, between the middles of bins; NaN if it does not."""
    beyond = np.flatnonzero(np.abs(departure) > tolerance)
    if not len(beyond):
        return float("nan")
    k = int(beyond[0])
    if k == 0:
        return float(at[0])
    share = (tolerance - abs(departure[k - 1])) / (abs(departure[k]) - abs(departure[k - 1]))
    return float(at[k - 1] + share * (at[k] - at[k - 1]))


def _black_level(counts: np.ndarray, seconds: np.ndarray, dark: np.ndarray) -> float:
    """Median intercept of lines through the dark counts of pixels that have at least two."""
    number = dark.sum(0)
    some = number >= 2
    if some.sum() < LEAST_SAMPLES:
        return float("nan")
    weight, n = dark[:, some].astype(np.float64), number[some]
    t = seconds[:, None] - (weight * seconds[:, None]).sum(0) / n
    mean = (weight * counts[:, some]).sum(0) / n
    slope = (weight * t * counts[:, some]).sum(0) / (weight * t**2).sum(0)
    return float(np.median(mean - slope * (weight * seconds[:, None]).sum(0) / n))
