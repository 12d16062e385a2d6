"""Faults of LEDs, dead or stuck, and frames under another pattern than the logged one.

Residuals of all frames and rows together are taken as normal with covariance S x K: K across rows and frame variances
as in `brightness`, and across frames what frames share: the static error of each light (frames under the same lights
err alike), every row's gain, and light that is always there. Against that an LED l that is dead changes the prediction
by D = -x[:, l] g[:, l]^T, one stuck at level s by (s - x[:, l]) g[:, l]^T, and the log-likelihood ratio is linear and
quadratic in D: tr(K^-1 R^T S^-1 D) - 1/2 tr(K^-1 D^T S^-1 D). The square root of the last trace is how many sigmas such
a fault would stand out by: LEDs for which that is little cannot be judged, and are named.

Frames are judged by how far they lie from what the other frames predict for them. Faults are taken out one by one, the
clearest first, since each of them leaves traces in what the others are judged by.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float64

from pipeline.base.distributions import f_quantile
from pipeline.sync.brightness import DEGREES, DYNAMIC, STATIC, BrightnessModel, log_likelihood
from pipeline.sync.offset_viterbi import LARGEST_SCALE, pattern_likelihoods, unknown_pattern

ANY_GAIN = 1.0
"""Deviation of a row's gain from the estimated one: wide, so that whatever changes all frames in proportion, such as a
dead LED among ever-lit ones, is no evidence."""

ALWAYS_THERE = 0.02
"""Deviation of light that no LED sends, relative to a mean frame: black level, a room lamp."""

REWEIGHTINGS = 3
"""Rounds of weights and scale: each shrinks their error by an order; the third changes no digit that is shown."""

CLEARLY_LIT = 2.5
"""Sigmas by which a light that does not follow its log has to be brighter than dark to be called always on."""

NOT_FOLLOWING = 0.3
"""Share of a light's logged intensity that may be left where it is dead or stuck. A light that only shades worse than
the stand-in (a low one behind an arm keeps 0.4) is neither, however sure that is."""

SMALLEST = 1e-12
"""Keeps ratios finite for a light of which nothing can be said."""

CONFIRMED = 0.75
"""Confidence that a true fault is confirmed with, over the separation that would follow from normal residuals, since
Student's t gives extreme ones less: 0.77 in the median of 72 simulated dead lights, 0.6 to 1 in their range."""

MOST_FAULTS = 0.25
"""Share of frames and lights that may be faulty before the log as a whole is in doubt."""


@dataclass(frozen=True)
class Patterns:
    """Patterns taken to have been on, `BrightnessModel.levels`, and the frames that take part."""

    levels: Float64[np.ndarray, "frames lights"]
    kept: Bool[np.ndarray, " frames"]


@dataclass(frozen=True)
class IndexedFault:
    """One fault: of a frame or of a light, by index.

    Attributes:
        kind: wrong_pattern, dead_light or stuck_light.
        sigmas: sqrt(2 log-likelihood ratio).
        value: level at which a light is stuck; row of the log that a frame shows
            instead, -1 if it fits none.
    """

    kind: str
    index: int
    sigmas: float
    value: float


@dataclass(frozen=True)
class Powers:
    """Sigmas by which each light would stand out if it were dead, or stuck at its usual level."""

    dead: Float64[np.ndarray, " lights"]
    stuck: Float64[np.ndarray, " lights"]


def find_faults(
    model: BrightnessModel, patterns: Patterns, sigmas: float
) -> tuple[list[IndexedFault], Patterns, Powers]:
    """Find the faults that stand out by `sigmas` or more.

    Returns:
        the faults, the patterns without them, and how clearly faults could have been seen.
    """
    found, most = [], int(np.ceil(MOST_FAULTS * sum(patterns.levels.shape)))
    fit = Fit(model, patterns)
    while len(found) < most and patterns.kept.sum() > 2:
        candidates = [fit.clearest_frame(), *(confirm(light, fit, patterns) for light in fit.clearest_lights())]
        best = max(candidates, key=lambda fault: fault.sigmas)
        if best.sigmas < sigmas:
            break
        found.append(best)
        patterns = without(best, patterns)
        fit = Fit(model, patterns)
    return found, patterns, fit.powers


def confirm(light: IndexedFault, fit: Fit, patterns: Patterns) -> IndexedFault:
    """The fault with its confidence from a fit that believes it.

    Gains and noise are then no longer bent by it. 0 if in that fit the light does follow its log, or one that is always
    on might as well be dead.
    """
    logged = patterns.levels[fit.rows, light.index]
    for _ in range(REWEIGHTINGS):
        believed = Fit(fit.model, without(light, patterns))
        more, deviation = believed.along(light.index, np.ones(len(logged)))
        if light.kind == "stuck_light":
            light = replace(light, value=max(light.value + more, 0.0))
    follows, unsure = believed.along(light.index, logged)
    doubtful = light.kind == "stuck_light" and light.value < CLEARLY_LIT * deviation
    if doubtful or follows > max(NOT_FOLLOWING, 2 * unsure):
        return replace(light, sigmas=0.0)
    return replace(light, sigmas=_sigmas(believed.score - fit.score))


def without(fault: IndexedFault, patterns: Patterns) -> Patterns:
    """Patterns with a fault believed: the frame left out, the light at its constant level."""
    if fault.kind == "wrong_pattern":
        return replace(patterns, kept=patterns.kept & (np.arange(len(patterns.kept)) != fault.index))
    levels = patterns.levels.copy()
    levels[:, fault.index] = fault.value
    return replace(patterns, levels=levels)


class Fit:
    """The frames that are kept, against the patterns that are believed."""

    def __init__(self, model: BrightnessModel, patterns: Patterns):
        self.model, self.rows = model, np.flatnonzero(patterns.kept)
        self.levels = patterns.levels[self.rows]
        predicted = model.predicted(patterns.levels)
        self.gains = model.gains(predicted, patterns.kept)
        self.residuals = model.observed[self.rows] / self.gains - predicted[self.rows]
        self._weigh()

    def _weigh(self) -> None:
        """Set S^-1, and each frame's distance from what the others predict, with its variance."""
        terms = self.model.terms(self.levels)
        level, rows = terms.sum(1), self.residuals.shape[1]
        own = DYNAMIC**2 * self.model.light_variance(terms) + self.model.steady_variance(terms)
        shared = STATIC**2 * terms @ self.model.light_correlation @ terms.T
        nuisance = ANY_GAIN**2 * np.outer(level, level) + (ALWAYS_THERE * self.model.usual_level) ** 2
        weights, self.scale = np.ones(len(own)), 1.0
        for _ in range(REWEIGHTINGS):
            self.inverse = np.linalg.inv(self.scale**2 * (shared + np.diag(own / weights)) + nuisance)
            pull = self.inverse.diagonal()
            # Leaving one out: the others predict it to within (S^-1 R)_f / (S^-1)_ff, of variance 1 / (S^-1)_ff.
            self.distances = self.model.squared_distance(self.inverse @ self.residuals / pull[:, None])
            self.variances = 1 / pull - self.scale**2 * (own / weights - own)
            relative = self.distances / self.variances
            weights = np.minimum((DEGREES + rows) / (DEGREES + relative), 1)
            excess = np.median(relative) / rows / f_quantile(0.5, rows, DEGREES)
            self.scale = float(np.clip(self.scale * np.sqrt(excess), 1 / LARGEST_SCALE, LARGEST_SCALE))

    def clearest_frame(self) -> IndexedFault:
        """The frame that fits its pattern least, compared with any other pattern, logged or not."""
        model, count = self.model, self.residuals.shape[1]
        seen = model.observed[self.rows] / self.gains
        logged, variance = model.predicted(model.levels), self.scale**2 * model.variance(model.levels)
        others = unknown_pattern(model, seen, logged, variance)
        ratios = others - log_likelihood(self.distances, self.variances, count)
        worst = int(ratios.argmax())
        fits = pattern_likelihoods(model, seen[worst : worst + 1], logged, variance)[0]
        alike = (model.levels == model.levels[fits.argmax()]).all(1)
        # Named only if more likely than not: half of the prior is the log's, as `unknown_pattern` has it.
        likely = np.exp(fits[alike] - others[worst]).sum() / (2 * len(fits)) > 0.5
        shows = int(fits.argmax()) if likely else -1
        return IndexedFault("wrong_pattern", int(self.rows[worst]), _sigmas(ratios[worst]), float(shows))

    @cached_property
    def score(self) -> float:
        """Log-likelihood of each frame given the others, summed.

        It is in the units of the images, hence the gains.
        """
        likelihood = log_likelihood(self.distances, self.variances, self.residuals.shape[1])
        return float(likelihood.sum() - len(self.rows) * np.log(self.gains).sum())

    def clearest_lights(self) -> list[IndexedFault]:
        """The light that is most likely dead and the one that is most likely stuck, to be confirmed."""
        change = self._change
        dead = change.off - change.off_off / 2
        level = np.maximum((change.on - change.off_on) / change.on_on, 0)
        stuck = dead + level * (change.on - change.off_on) - level**2 * change.on_on / 2
        first, second = int(dead.argmax()), int(stuck.argmax())
        return [
            IndexedFault("dead_light", first, _sigmas(dead[first]), 0.0),
            IndexedFault("stuck_light", second, _sigmas(stuck[second]), float(level[second])),
        ]

    def along(self, light: int, levels: np.ndarray) -> tuple[float, float]:
        """Share of these levels [frames] that a light gives beyond belief, and its deviation."""
        response = self.model.response[:, light]
        pulled = self.inverse @ levels
        square = (levels @ pulled) * (response @ self.model.precision @ response)
        square = max(float(square), SMALLEST)
        return float(pulled @ self.residuals @ self.model.precision @ response) / square, square**-0.5

    @cached_property
    def powers(self) -> Powers:
        """Confidence by which faults of each light would show."""
        lit = (self.levels > 0).sum(0)
        anywhere = self.levels[self.levels > 0].mean() if lit.any() else 0.0
        usual = np.where(lit > 0, self.levels.sum(0) / np.maximum(lit, 1), anywhere)
        change = self._change
        stuck = change.off_off + 2 * usual * change.off_on + usual**2 * change.on_on
        return Powers(CONFIRMED * np.sqrt(np.maximum(change.off_off, 0)), CONFIRMED * np.sqrt(np.maximum(stuck, 0)))

    @cached_property
    def _change(self) -> _Change:
        """Of the log-likelihood with D = (-t x + s) g^T per light."""
        over_cameras = ((self.model.precision @ self.model.response) * self.model.response).sum(0)
        pulled = self.inverse @ self.levels
        pull = self.inverse @ self.residuals @ self.model.precision @ self.model.response
        return _Change(
            off=-(self.levels * pull).sum(0),
            on=pull.sum(0),
            off_off=np.maximum((self.levels * pulled).sum(0) * over_cameras, SMALLEST),
            off_on=-pulled.sum(0) * over_cameras,
            on_on=np.maximum(self.inverse.sum() * over_cameras, SMALLEST),
        )


@dataclass(frozen=True)
class _Change:
    """t off + s on - (t^2 off_off + 2 t s off_on + s^2 on_on) / 2, each per light."""

    off: np.ndarray
    on: np.ndarray
    off_off: np.ndarray
    off_on: np.ndarray
    on_on: np.ndarray


def _sigmas(ratio: float) -> float:
    """Of a log-likelihood ratio: sqrt(2 ratio), 0 where the fault is the less likely."""
    return float(np.sqrt(2 * max(ratio, 0.0)))
