"""Does a change of the avatar change its scores, or do only the held-out images differ?

Scores of one subject are no independent draws: all cameras of a frame share pose and light, and neighbouring frames
share most of their pose. So frames are cut, in order, into a few blocks, and the t-test is on the blocks: it is valid
for blocks of unequal spread that are nearly independent (Ibragimov and Mueller, "t-statistic based correlation and
heterogeneity robust inference", 2010, section 2: never too eager at levels up to 8 %).

Two questions are asked. *Would it hold for new frames of these subjects?* Its uncertainty is that of the blocks.
*Would it hold for new subjects?* Its uncertainty is the spread between subjects; with few of them the test, a t-test of
their means, has little power and leans on these being normally distributed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int

from pipeline.base.distributions import student_tail

BLOCKS = 8
"""Of consecutive frames. More give the test more power; fewer make the blocks longer and so less alike. From 8 on, a
critical value (2.36 at 5 %) close to the normal one (1.96) is all there is to win. Where nothing is to be found, the
test finds something at 5 % in about 5 % of drawn captures; in 9 % of those with only 24 frames whose neighbours
correlate by 0.5, since blocks of three frames are still a little alike (tests/unit/metrics/test_significance.py)."""


@dataclass(frozen=True)
class Estimate:
    """A mean with its uncertainty.

    Attributes:
        error: standard error; NaN if there are too few blocks or subjects to tell.
        degrees: of freedom, of the error.
    """

    mean: float
    error: float
    degrees: float

    @property
    def p_value(self) -> float:
        """Two-sided, of a true mean of zero; NaN without an error. A mean of exactly zero has 1."""
        if not math.isfinite(self.error):
            return math.nan
        if self.mean == 0 or self.error == 0:
            return float(self.mean == 0)
        return 2 * student_tail(abs(self.mean) / self.error, self.degrees)


NOTHING = Estimate(math.nan, math.nan, math.nan)


def mean_over_images(value: Float64[np.ndarray, " images"], frame: Int[np.ndarray, " images"]) -> Estimate:
    """Mean over images with the standard error over frames.

    The error says how far the mean would be from that of other frames of the same motion and cameras.

    The error is that of blocks of `BLOCKS` runs of frames: with u_b the sum over block b of value - mean, it is
    sqrt(B / (B - 1) sum u_b^2) / images, which is the usual error of B block means if blocks have equally many images.
    """
    if len(value) == 0:
        return NOTHING
    mean = float(value.mean())
    block = frame_blocks(frame)
    count = np.count_nonzero(np.bincount(block))
    if count < 2:
        return Estimate(mean, math.nan, math.nan)
    excess = np.bincount(block, value - mean)
    return Estimate(mean, float(np.sqrt(count / (count - 1) * (excess**2).sum()) / len(value)), count - 1.0)


def frame_blocks(frame: Int[np.ndarray, " images"]) -> Int[np.ndarray, " images"]:
    """Block number of each image.

    Blocks are runs of frames with about equally many images; a frame is never cut.
    """
    frames, row, images = np.unique(frame, return_inverse=True, return_counts=True)
    middle = np.cumsum(images) - images / 2
    return (np.minimum(BLOCKS, len(frames)) * middle / len(frame)).astype(int)[row]


def over_these_subjects(estimates: Sequence[Estimate]) -> Estimate:
    """The mean of subjects' means, each counting the same, for new frames of the same subjects.

    Degrees of freedom are Satterthwaite's: (sum e_s^2)^2 / sum (e_s^4 / degrees_s).
    """
    mean = float(np.mean([estimate.mean for estimate in estimates]))
    variances = np.array([estimate.error**2 for estimate in estimates])
    degrees = np.array([estimate.degrees for estimate in estimates])
    error = float(np.sqrt(variances.sum()) / len(estimates))
    if not error > 0:  # NaN, or nothing varies
        return Estimate(mean, error, float(degrees.sum()))
    return Estimate(mean, error, float(variances.sum() ** 2 / (variances**2 / degrees).sum()))


def over_new_subjects(estimates: Sequence[Estimate]) -> Estimate:
    """Mean of subjects' means, with the standard error for new subjects.

    The subjects count as drawn from all; the error is that of their spread.
    """
    means = np.array([estimate.mean for estimate in estimates])
    if len(means) < 2:
        return Estimate(float(means.mean()), math.nan, math.nan)
    return Estimate(float(means.mean()), float(means.std(ddof=1) / np.sqrt(len(means))), len(means) - 1.0)


def holm(p_values: Float64[np.ndarray, " tests"]) -> Float64[np.ndarray, " tests"]:
    """Correct p-values for there being several, by Holm's method (1979).

    The chance of any false find at level a is at most a.

    NaN are no tests and stay NaN.
    """
    corrected = np.full(len(p_values), np.nan)
    known = np.flatnonzero(np.isfinite(p_values))
    order = known[np.argsort(p_values[known], kind="stable")]
    steps = p_values[order] * np.arange(len(order), 0, -1)
    corrected[order] = np.minimum(1, np.maximum.accumulate(steps))
    return corrected
