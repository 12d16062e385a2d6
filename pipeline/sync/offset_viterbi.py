"""Offset between LED log and images in every frame, by Viterbi's algorithm.

Frame f shows the pattern logged for f + k[f]. On a stage in step k is 0; one whose counts started apart has a constant
k; where an image was lost k grows by one from there on, where one was stored twice it falls by one. Every change, and a
start other than 0, has to raise the likelihood by `sigmas` deviations, that is its logarithm by sigmas^2 / 2 and, for a
change, by the odds of it. A single frame may show something else altogether, so its likelihood never falls far below
that of an unknown pattern.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float64, Int64
from scipy.special import logsumexp

from pipeline.base.distributions import f_quantile
from pipeline.sync.brightness import DEGREES, BrightnessModel, log_likelihood

STRANGE_SHARE = 1e-3
"""Share of frames that show something else than any pattern near them, expected before anything is seen."""

WIDEST_ODDS = 0.3
"""Spread of an unknown pattern's brightness, relative to the usual level, at least: a capture that only ever is fully
lit still has to recognise a dark frame."""

SCALE_QUANTILE = 0.3
"""The noise's scale is read off the frames' distances at this quantile: up to two thirds of them may be faulty."""

LARGEST_SCALE = 3.0
"""Noise, relative to `brightness`, beyond which the log is said not to explain the images: two captures have 0.9 and
1.1; images of other patterns than the log's would pass with 6."""

LARGEST_CORRELATION = 0.99
"""Between neighbouring frames' residuals: keeps some evidence, however alike they are."""

SHORTEST_RUN = 3
"""Frames that have to speak for another offset: a single frame under a wrong pattern often matches a neighbour's."""


@dataclass(frozen=True)
class LogOffsets:
    """Offset of the log in each frame, and the evidence for it.

    Attributes:
        offsets: of each frame, see the module's docstring.
        tried: constant offsets; the columns of `evidence`.
        evidence: log-likelihood of each frame at each offset, less that of an unknown pattern.
        scale: of the noise, relative to `brightness`.
        independent: share of the frames that count as independent.
    """

    offsets: Int64[np.ndarray, " frames"]
    tried: Int64[np.ndarray, " offsets"]
    evidence: Float64[np.ndarray, "frames offsets"]
    scale: float
    independent: float

    def sigmas(self, offset: int, than: int, frames: slice = slice(None)) -> float:
        """Confidence that these frames have one offset rather than another.

        It is sqrt(2 log-likelihood ratio), signed.
        """
        columns = [int(np.flatnonzero(self.tried == k)[0]) for k in (offset, than)]
        gained = self.evidence[frames][:, columns].sum(0)
        ratio = gained[0] - gained[1]
        return float(np.copysign(np.sqrt(2 * abs(ratio)), ratio))

    def runs(self) -> list[tuple[int, int]]:
        """First and last row of every run of frames with one offset."""
        edges = [0, *(np.flatnonzero(np.diff(self.offsets)) + 1).tolist(), len(self.offsets)]
        return [(first, end - 1) for first, end in pairwise(edges)]


def find_log_offsets(model: BrightnessModel, max_offset: int, sigmas: float) -> LogOffsets:
    """The most likely offsets within +-`max_offset` frames."""
    tried = np.arange(-max_offset, max_offset + 1)
    predicted, variance = model.predicted(model.levels), model.variance(model.levels)
    rows, count = model.log.rows_for(model.frames[:, None] + tried), model.observed.shape[1]
    gains = np.stack([model.gains(predicted[row], row >= 0) for row in rows.T])
    residuals = model.observed[:, None] / gains - predicted[rows]
    distances = np.where(rows < 0, np.inf, model.squared_distance(residuals))
    scale = noise_scale(distances / variance[rows], count)
    known = log_likelihood(distances, scale**2 * variance[rows], count)
    unknown = np.stack(
        [unknown_pattern(model, model.observed / gain, predicted, scale**2 * variance) for gain in gains], 1
    )
    evidence = np.where(rows < 0, 0.0, np.logaddexp(known - unknown, np.log(STRANGE_SHARE)))
    # Whichever constant offset fits best tells how alike the errors of neighbouring frames are.
    best = evidence.sum(0).argmax()
    independent = independent_share(residuals[:, best], distances[:, best], variance[rows[:, best]], model)
    evidence = evidence * independent
    path = _most_likely(evidence, max_offset, sigmas**2 / 2)
    return LogOffsets(tried[_without_short_runs(path)], tried, evidence, scale, independent)


def noise_scale(relative: Float64[np.ndarray, "frames offsets"], rows: int) -> float:
    """Deviation of the residuals over what the model says, at most `LARGEST_SCALE`.

    Args:
        relative: r^T K^-1 r / v of the frames at the offsets tried; infinite where there is nothing to compare.
        rows: entries of r.
    """
    quantiles = np.quantile(relative / rows, SCALE_QUANTILE, axis=0, method="lower")
    # Of Student's t in `rows` dimensions, r^T K^-1 r / (rows v) is distributed as F(rows, DEGREES).
    expected = f_quantile(SCALE_QUANTILE, rows, DEGREES)
    return float(np.clip(np.sqrt(quantiles.min() / expected), 1 / LARGEST_SCALE, LARGEST_SCALE))


def unknown_pattern(
    model: BrightnessModel, seen: np.ndarray, predicted: np.ndarray, variance: np.ndarray
) -> Float64[np.ndarray, " frames"]:
    """Log-likelihood of each frame under an unknown pattern: any logged one, or a new one alike.

    That one of many dark or fully lit frames fits another is then no evidence; that a rare pattern fits is.

    Args:
        seen: observed brightness over the gains, [frames, cameras].
        predicted, variance: of the logged patterns, [logged, cameras] and [logged].
    """
    fits = pattern_likelihoods(model, seen, predicted, variance)
    rows = seen.shape[1]
    lit = predicted.sum(1) > 0
    known = predicted[lit] if lit.any() else predicted
    widest = variance.mean() + (WIDEST_ODDS * model.usual_level) ** 2
    covariance = np.cov(known.T, bias=True).reshape(rows, rows) + widest * model.camera_correlation
    offsets = seen - known.mean(0)
    distance = (np.linalg.solve(covariance, offsets.T).T * offsets).sum(1)
    # As `log_likelihood`, which leaves log det K out for all hypotheses.
    volume = np.exp((np.linalg.slogdet(covariance)[1] - np.linalg.slogdet(model.camera_correlation)[1]) / rows)
    new = log_likelihood(distance * volume, np.full(len(seen), volume), rows)
    return np.logaddexp(logsumexp(fits, axis=1) - np.log(fits.shape[1]), new) - np.log(2)


def pattern_likelihoods(
    model: BrightnessModel, seen: np.ndarray, predicted: np.ndarray, variance: np.ndarray
) -> Float64[np.ndarray, "frames logged"]:
    """Log-likelihood of each frame under each logged pattern; arguments as of `unknown_pattern`."""
    root = np.linalg.cholesky(model.precision)
    ours, theirs = seen @ root, predicted @ root
    distances = (ours**2).sum(1)[:, None] + (theirs**2).sum(1) - 2 * ours @ theirs.T
    return log_likelihood(np.maximum(distances, 0), variance, seen.shape[1])


def independent_share(
    residuals: np.ndarray, distances: np.ndarray, variance: np.ndarray, model: BrightnessModel
) -> float:
    """Independent samples per frame, (1 - a) / (1 + a).

    The correlation of neighbouring frames' residuals is a. A subject that turns slowly under patterns that change
    slowly fits best at some arbitrary offset, frame after frame for one and the same reason; this keeps one reason from
    counting once per frame.

    Args:
        residuals: [frames, rows]; distances: their r^T K^-1 r, infinite for frames to leave out; variance: their v.
    """
    # Weights of Student's t: a frame under a wrong pattern does not drown the others.
    weights = np.where(np.isfinite(distances), 1 / np.sqrt(variance + distances / residuals.shape[1]), 0.0)
    whitened = residuals * weights[:, None]
    product = ((whitened[1:] @ model.precision) * whitened[:-1]).sum()
    square = model.squared_distance(whitened).sum()
    correlation = np.clip(product / square if square > 0 else 0.0, 0, LARGEST_CORRELATION)
    return float((1 - correlation) / (1 + correlation))


def _most_likely(evidence: np.ndarray, start: int, cost: float) -> np.ndarray:
    """Column of `evidence` per frame: the path of the largest sum (Viterbi's algorithm).

    Another start than column `start` costs `cost`, a change as much and the odds of a fault in a frame.
    """
    count, columns = evidence.shape
    total = evidence[0] - cost * (np.arange(columns) != start)
    cost = cost - np.log(STRANGE_SHARE)
    came_from = np.zeros((count, columns), np.int64)
    for frame in range(1, count):
        best = int(total.argmax())
        stays = total >= total[best] - cost
        came_from[frame] = np.where(stays, np.arange(columns), best)
        total = np.where(stays, total, total[best] - cost) + evidence[frame]
    path = np.empty(count, np.int64)
    # Ties go to the offset nearest to 0.
    order = np.argsort(np.abs(np.arange(columns) - start), kind="stable")
    path[-1] = order[total[order].argmax()]
    for frame in range(count - 1, 0, -1):
        path[frame - 1] = came_from[frame, path[frame]]
    return path


def _without_short_runs(path: np.ndarray) -> np.ndarray:
    """Merge runs shorter than `SHORTEST_RUN` into the run before, the first into the run after."""
    edges = [0, *(np.flatnonzero(np.diff(path)) + 1), len(path)]
    kept = path.copy()
    for first, end in pairwise(edges):
        if end - first < SHORTEST_RUN and end - first < len(path):
            kept[first:end] = kept[first - 1] if first else path[end]
    return kept
