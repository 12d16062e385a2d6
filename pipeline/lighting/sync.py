"""Is the LED log in step with the images? At which offset do predicted and observed brightness change together?

Compared are changes from frame to frame, not levels: a subject that slowly turns into the light drifts in brightness,
and so may a slowly varying pattern; levels of the two then correlate best at some arbitrary offset (a false alarm in 1
of 300 simulated captures), changes do not. An offset is accepted only if its correlation is clearly higher than that of
the declared timing: two lines fitted to the same n changes, leaving shares 1 - r_k^2 and 1 - r_0^2 of their variance,
differ in log-likelihood by n / 2 log((1 - r_0^2) / (1 - r_k^2)) (Gaussian residuals), n being the number of
independent changes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

CLEARLY_BETTER_SIGMA = 5.0
"""Square root of twice the log-likelihood gained, above which another offset counts as clearly better. For a pattern
that has nothing to do with the images it is distributed as |normal|: 6e-7 per offset, 6e-6 for ten, and only if the
pattern explains the images at all (`EXPLAINS`). On a stage in sync, where the declared timing explains more, it is
negative."""

EXPLAINS = 0.5
"""Correlation above which a pattern is said to explain the brightness. Chance reaches 0.5 with 30 changes only at
3 sigma; shading and shadows, which the prediction ignores, leave 0.9 on a real pattern."""

FEWEST_CHANGES = 12
"""Fisher's transform of a correlation has deviation 1 / sqrt(n - 3): a third at 12. Fewer frames say nothing."""

ROUNDING = 1e-9
"""Changes smaller than this share of the mean brightness are float64 rounding of a constant pattern."""

IN_SYNC, OUT_OF_SYNC, UNDETERMINED = "in_sync", "out_of_sync", "undetermined"


@dataclass(frozen=True)
class SyncCheck:
    """What the comparison found.

    Attributes:
        offset_frames: k, where images of frame f show the pattern logged for frame f + k; 0 unless `out_of_sync`.
        correlation: of the changes at that offset; NaN if undefined.
        sigmas: how clearly that offset beats the declared timing, see `CLEARLY_BETTER_SIGMA`; 0 at offset 0.
        verdict: in_sync, out_of_sync or undetermined.
        why: the verdict in a sentence.
        correlations: of the changes, for every offset tried.
    """

    offset_frames: int
    correlation: float
    sigmas: float
    verdict: str
    why: str
    correlations: dict[int, float] = field(default_factory=dict)


def check_sync(predicted: pd.Series, observed: pd.Series, max_offset: int = 5) -> SyncCheck:
    """Compare brightness per frame, both indexed by frame number.

    Args:
        predicted: brightness by the LED log; 0 for frames in the dark.
        observed: brightness of the images; NaN or absent where there is no image.
        max_offset: largest offset tried, frames.
    """
    offsets = sorted(range(-max_offset, max_offset + 1), key=abs)
    correlations, sigmas = {}, {}
    for offset in offsets:
        changes = _changes(predicted, observed, offset)
        correlations[offset], sigmas[offset] = _compare(changes, abs(float(predicted.mean())))
    if not math.isfinite(correlations[0]):
        return SyncCheck(
            0, math.nan, 0.0, UNDETERMINED, "too few frames, or no change of light to compare", correlations
        )
    best = max(offsets, key=lambda k: correlations[k] if math.isfinite(correlations[k]) else -1.0)
    found, declared = correlations[best], correlations[0]
    if found < EXPLAINS:
        why = (
            f"no offset explains the brightness: best correlation {found:.2f} at {best:+d}, {declared:.2f} as declared"
        )
        return SyncCheck(0, declared, 0.0, UNDETERMINED, why, correlations)
    if best == 0:
        return SyncCheck(
            0, declared, 0.0, IN_SYNC, f"correlation {declared:.2f}, the best of all offsets", correlations
        )
    why = f"correlation {found:.2f} at {best:+d} frames, {declared:.2f} as declared: {sigmas[best]:.1f} sigma"
    if sigmas[best] >= CLEARLY_BETTER_SIGMA:
        return SyncCheck(best, found, sigmas[best], OUT_OF_SYNC, why, correlations)
    verdict = IN_SYNC if declared >= EXPLAINS else UNDETERMINED
    return SyncCheck(0, declared, 0.0, verdict, why + ", not clearly better", correlations)


def _changes(predicted: pd.Series, observed: pd.Series, offset: int) -> np.ndarray:
    """Changes [n, 3] between consecutive frames: observed, predicted at `offset`, predicted as declared."""
    shifted = pd.Series(predicted.to_numpy(), predicted.index - offset)
    frames = np.arange(observed.index.min(), observed.index.max() + 1)
    columns = [series.reindex(frames).to_numpy(dtype=np.float64) for series in (observed, shifted, predicted)]
    changes = np.diff(np.stack(columns, -1), axis=0)
    return changes[np.isfinite(changes).all(1)]


def _compare(changes: np.ndarray, level: float) -> tuple[float, float]:
    """(correlation at the offset, sigmas by which it beats the declared timing); NaN, 0 where they are undefined."""
    if len(changes) < FEWEST_CHANGES:
        return math.nan, 0.0
    deviation = changes.std(0)
    if deviation[0] == 0 or (deviation[1:] <= ROUNDING * level).any():
        return math.nan, 0.0
    at_offset, declared = np.corrcoef(changes.T)[0, 1:]
    left = np.clip(1 - np.square([declared, at_offset]), ROUNDING, 1.0)
    gain = _independent_count(changes[:, 0], changes[:, 1]) / 2 * float(np.log(left[0] / left[1]))
    return float(at_offset), math.copysign(math.sqrt(2 * abs(gain)), gain)


def _independent_count(observed: np.ndarray, predicted: np.ndarray) -> float:
    """Independent samples among serially correlated changes, by Bartlett's first lag: n (1 - ab) / (1 + ab).

    a, b: lag-1 correlations of the two. Differencing alone makes both -0.5 for a random pattern.
    """
    a, b = (
        float(np.corrcoef(c[1:], c[:-1])[0, 1]) if c[1:].std() and c[:-1].std() else 0.0 for c in (observed, predicted)
    )
    shared = max(a * b, 0.0)
    return len(observed) * (1 - shared) / (1 + shared)
