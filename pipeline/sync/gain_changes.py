"""Changes of exposure: frames, images and parts of a recording that differ in brightness.

A change multiplies brightness: the prediction m of the frames and cameras that it concerns becomes (1 + g) m. Under the
residuals' covariance S x K (`led_faults`) g and its deviation follow by generalized least squares. For a frame, or one
of its images, against what all other frames predict for it; for a camera from some frame on, against its own frames
before, since the gain of a camera over all frames is a nuisance in S.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from pipeline.base.distributions import student_quantile
from pipeline.sync.brightness import DEGREES, BrightnessModel
from pipeline.sync.led_faults import Fit, Patterns

FALSE_ALARMS = 1e-3
"""Probability that anything of a sound capture is called changed; shared out over all that is tested (Bonferroni)."""

CLICK = 0.5 * (2 ** (1 / 3) - 1)
"""Half of the smallest step of an exposure dial, a third of a stop: a part of a recording that differs by less was not
set so, but is how a body that has turned differs from its stand-in."""

SHORTEST_PART = 3
"""Frames before and after a change: fewer are frames and images of their own."""


@dataclass(frozen=True)
class GainChange:
    """One change of brightness that no light explains.

    Attributes:
        camera: None if all have it.
        frame: the frame that has it, or the first one.
        lasting: whether all later frames have it, too.
        factor: brightness over the expected one.
        sigmas: of factor - 1.
    """

    camera: int | None
    frame: int
    lasting: bool
    factor: float
    sigmas: float

    def __str__(self) -> str:
        place = f"from frame {self.frame} on" if self.lasting else f"in frame {self.frame}"
        return f"{self.factor:.2f} times as bright {place} ({abs(self.sigmas):.0f} sigma)"


def find_gain_changes(model: BrightnessModel, patterns: Patterns) -> list[GainChange]:
    """Find frames and images that differ, or else the clearest lasting change.

    The latter if it is clearer than they are: it makes frames differ, too.
    """
    fit = Fit(model, patterns)
    predicted = model.predicted(patterns.levels)[fit.rows]
    frames, cameras = predicted.shape
    tests = (frames + frames) * (1 + cameras)
    least = student_quantile(1 - FALSE_ALARMS / (2 * tests), DEGREES)
    single = [change for change in _single(fit, predicted) if abs(change.sigmas) > least]
    lasting = [change for change in _lasting(fit, predicted) if abs(change.sigmas) > least]
    lasting = [change for change in lasting if abs(change.factor - 1) > CLICK]
    clearest = max([*lasting, *single], key=lambda change: abs(change.sigmas), default=None)
    return single if clearest is None or not clearest.lasting else [clearest]


def _single(fit: Fit, predicted: np.ndarray) -> Iterator[GainChange]:
    """For each frame its own change or that of one of its images, whichever is the clearer.

    Of a change that all images share, the frame's is: that of a part of it is less clear by Schwarz's inequality, and
    the other way round.
    """
    expected = fit.inverse @ fit.residuals / fit.inverse.diagonal()[:, None]  # Seen, less what the others predict.
    pulled, own = expected @ fit.model.precision, fit.model.precision.diagonal()
    gain, deviation = _along(pulled, predicted, fit.model.precision, fit.variances)
    lit = predicted > 0
    mine = np.where(lit, predicted, 1.0)
    share, spread = pulled / mine / own, np.where(lit, np.sqrt(fit.variances[:, None] / own) / mine, np.inf)
    for row, camera in enumerate(np.abs(share / spread).argmax(1)):
        yield max(
            _change(fit, None, row, gain[row], deviation[row], False),
            _change(fit, int(camera), row, share[row, camera], spread[row, camera], False),
            key=lambda change: abs(change.sigmas),
        )


def _along(
    pulled: np.ndarray, predicted: np.ndarray, precision: np.ndarray, variance: np.ndarray
) -> tuple[Float64[np.ndarray, " frames"], Float64[np.ndarray, " frames"]]:
    """Gain of each frame along its prediction, and its deviation; infinite where it is dark."""
    square = ((predicted @ precision) * predicted).sum(1)
    lit = square > 0
    gain = np.where(lit, (pulled * predicted).sum(1) / np.where(lit, square, 1), 0.0)
    return gain, np.where(lit, np.sqrt(variance / np.where(lit, square, 1)), np.inf)


def _lasting(fit: Fit, predicted: np.ndarray) -> Iterator[GainChange]:
    """The clearest lasting change of all cameras together, and of each."""
    precision = fit.model.precision
    pulled = fit.inverse @ fit.residuals @ precision
    whole = fit.inverse * (predicted @ precision @ predicted.T)
    if (found := _clearest((pulled * predicted).sum(1), whole)) is not None:
        yield _change(fit, None, *found, True)
    for camera in range(predicted.shape[1]):
        mine = predicted[:, camera]
        square = precision[camera, camera] * fit.inverse * np.outer(mine, mine)
        if (found := _clearest(pulled[:, camera] * mine, square)) is not None:
            yield _change(fit, camera, *found, True)


def _clearest(
    pull: Float64[np.ndarray, " frames"], square: Float64[np.ndarray, "frames frames"]
) -> tuple[int, float, float] | None:
    """Row from which a gain is most significant, the gain and its deviation.

    Args:
        pull: score of a gain of each frame alone.
        square: information on the gains of two frames.
    """
    # Of gains of all frames from each row on: sums over the rows below, and over the blocks below.
    score = np.cumsum(pull[::-1])[::-1]
    known = np.cumsum(np.cumsum(square[::-1, ::-1], 0), 1).diagonal()[::-1]
    rows = np.arange(SHORTEST_PART, len(pull) - SHORTEST_PART + 1)
    rows = rows[known[rows] > 0] if len(rows) else rows
    if not len(rows):
        return None
    row = int(rows[np.abs(score[rows] / np.sqrt(known[rows])).argmax()])
    return row, float(score[row] / known[row]), float(known[row] ** -0.5)


def _change(
    fit: Fit, camera: int | None, row: int, gain: float, deviation: float, lasting: bool
) -> GainChange:  # fmt: skip
    frame = int(fit.model.frames[fit.rows[row]])
    return GainChange(camera, frame, lasting, 1 + float(gain), float(gain / deviation))
