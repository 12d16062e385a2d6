"""Brightness of the subject in every camera as a log of patterns predicts it, and its error.

Observed is y[f, c], the mean of the subject in frame f and camera c over its pixels and channels. Predicted is m[f, c]
= sum_l x[f, l] g[c, l] with the response g of an ellipsoid (`subject_proxy`) and one gain per camera. What the
ellipsoid ignores, shape, shadows, pose, is a random error of the response (`DYNAMIC`, `STATIC`), alike for neighbouring
lights (C, `light_correlation`) and in cameras that look from alike directions (K, `camera_correlation`). A frame's
residual then has the covariance v[f] K with v[f] = s^2 a[f]^T C a[f] + ... and a[f, l] = x[f, l] mean_c g[c, l]. Since
bodies do worse things now and then, it follows Student's t.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float64, Int64

from pipeline.geometry.mesh import unit_or
from pipeline.lighting.frame_lights import CHANNELS

STATIC, DYNAMIC = 0.2, 0.1
"""Errors of the response to one light, relative to its mean over the cameras: one that stays over the capture, one that
is new in every frame. Maximum likelihood of two path-traced captures (`benchmarks/bench_sync.py` prints how well the
residuals follow); `scale` adapts them to a capture."""

STEADY = 0.01
"""Noise of a frame relative to its brightness: exposure, the LEDs' power."""

FLOOR = 0.01
"""Noise relative to the brightness of a mean frame, in the dark too: sensor, stray light."""

NEARBY_CAMERAS, OWN_SHARE = 3.0, 0.1
"""Errors of cameras w apart in direction correlate as exp(NEARBY_CAMERAS (cos w - 1)): a half at 40 degrees; but for
the share that is each camera's own. Maximum likelihood, as above."""

NEARBY_LIGHTS, LIGHTS_OWN_SHARE = 4.0, 0.5
"""The same for lights: what is wrong for one is half as wrong for its neighbours, up to about 35 degrees."""

DEGREES = 15.0
"""Degrees of freedom of Student's t: maximum likelihood of 72 frames of two path-traced captures is 15 to 20."""


@dataclass(frozen=True)
class PatternLog:
    """The log as a matrix.

    Attributes:
        numbers: frames that the log speaks of, increasing; one that lists no light was dark.
        levels: radiant intensity of each light, linear RGB.
    """

    numbers: Int64[np.ndarray, " logged"]
    lights: list[str]
    levels: Float64[np.ndarray, "logged lights 3"]

    def rows_for(self, frames: Int64[np.ndarray, "*n"]) -> Int64[np.ndarray, "*n"]:
        """Row of each frame number; -1 for those that the log does not know."""
        rows = np.searchsorted(self.numbers, frames).clip(max=len(self.numbers) - 1)
        return np.where(self.numbers[rows] == frames, rows, -1)


def read_log(patterns: pd.DataFrame, frames: pd.Series, lights: list[str]) -> PatternLog:
    """The log of all frames that either table names; `lights` are the columns."""
    numbers = np.unique(np.concatenate([frames.to_numpy(np.int64), patterns.frame.to_numpy(np.int64)]))
    levels = np.zeros((len(numbers), len(lights), 3))
    column = {light: index for index, light in enumerate(lights)}
    rows = np.searchsorted(numbers, patterns.frame.to_numpy())
    levels[rows, patterns.light.map(column).to_numpy(np.int64)] = patterns[CHANNELS].to_numpy(np.float64)
    return PatternLog(numbers, list(lights), levels)


def observed_table(means: pd.DataFrame, cameras: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Frames [F] that have images, and what was seen in them [F, cameras, 3].

    A camera that misses an image gets its mean times how bright that frame was for the others.

    Args:
        means: camera, frame, r, g, b.
    """
    wide = means.pivot(index="frame", columns="camera", values=["r", "g", "b"]).sort_index()
    seen = np.stack([wide[channel].reindex(columns=cameras).to_numpy(np.float64) for channel in "rgb"], 2)
    usual = np.nanmean(seen, 0)
    level = np.nanmean(seen / np.where(usual > 0, usual, np.nan), axis=(1, 2), keepdims=True)
    return wide.index.to_numpy(np.int64), np.where(np.isfinite(seen), seen, np.nan_to_num(level) * usual)


@dataclass(frozen=True)
class BrightnessModel:
    """Brightness seen in the images, and all that the log predicts of it.

    Attributes:
        frames: numbers of the frames that have images, increasing.
        seen: brightness of the images, linear RGB.
        response: of the subject's stand-in, `shading_response`, 1/m^2.
        camera_directions, light_directions: unit vectors from the subject to the cameras and lights.
    """

    log: PatternLog
    frames: Int64[np.ndarray, " frames"]
    seen: Float64[np.ndarray, "frames cameras 3"]
    response: Float64[np.ndarray, "cameras lights"]
    camera_directions: Float64[np.ndarray, "cameras 3"]
    light_directions: Float64[np.ndarray, "lights 3"]

    @cached_property
    def observed(self) -> Float64[np.ndarray, "frames cameras"]:
        """Mean of the channels."""
        return self.seen.mean(2)

    @cached_property
    def channel_weights(self) -> Float64[np.ndarray, " 3"]:
        """Weight of a light's channels in an image's mean, of mean 1: the subject's albedo.

        Brightness seen over light sent in each channel, over all frames: a log out of step hardly changes it.
        """
        sent = np.einsum("nlk,l->k", self.log.levels, self.response.mean(0))
        weights = np.where(sent > 0, self.seen.sum((0, 1)) / np.where(sent > 0, sent, 1), 0)
        return weights / weights.mean() if weights.mean() > 0 else np.ones(3)

    @cached_property
    def levels(self) -> Float64[np.ndarray, "logged lights"]:
        """Radiant intensity of a white light as bright on this subject as each logged one."""
        return self.log.levels @ self.channel_weights / 3

    def predicted(self, levels: Float64[np.ndarray, "n lights"]) -> Float64[np.ndarray, "n cameras"]:
        """Brightness of the stand-in under these patterns, up to a gain per camera."""
        return levels @ self.response.T

    def terms(self, levels: Float64[np.ndarray, "n lights"]) -> Float64[np.ndarray, "n lights"]:
        """Brightness that each light adds, averaged over cameras: a of the module's docstring."""
        return levels * self.response.mean(0)

    def variance(self, levels: Float64[np.ndarray, "n lights"]) -> Float64[np.ndarray, " n"]:
        """v of the module's docstring, for patterns whose static errors are not known."""
        terms = self.terms(levels)
        return (STATIC**2 + DYNAMIC**2) * self.light_variance(terms) + self.steady_variance(terms)

    def light_variance(self, terms: Float64[np.ndarray, "n lights"]) -> Float64[np.ndarray, " n"]:
        """a^T C a."""
        return ((terms @ self.light_correlation) * terms).sum(1)

    def steady_variance(self, terms: Float64[np.ndarray, "n lights"]) -> Float64[np.ndarray, " n"]:
        """The part of v that does not come from the lights one by one."""
        return (STEADY * terms.sum(1)) ** 2 + (FLOOR * self.usual_level) ** 2

    @cached_property
    def usual_level(self) -> float:
        """Brightness of the mean lit frame of the log."""
        totals = self.terms(self.levels).sum(1)
        return float(totals[totals > 0].mean()) if (totals > 0).any() else 1.0

    @cached_property
    def camera_correlation(self) -> Float64[np.ndarray, "cameras cameras"]:
        """K, of a frame's residuals."""
        return _correlation(self.camera_directions, NEARBY_CAMERAS, OWN_SHARE)

    @cached_property
    def light_correlation(self) -> Float64[np.ndarray, "lights lights"]:
        """C, of the response's errors."""
        return _correlation(self.light_directions, NEARBY_LIGHTS, LIGHTS_OWN_SHARE)

    @cached_property
    def precision(self) -> Float64[np.ndarray, "cameras cameras"]:
        """K^-1."""
        return np.linalg.inv(self.camera_correlation)

    def gains(self, predicted: np.ndarray, rows: Bool[np.ndarray, " frames"]) -> Float64[np.ndarray, " cameras"]:
        """Observed over predicted brightness, summed over the chosen frames.

        A log out of step hardly changes it.
        """
        total = predicted[rows].sum(0)
        observed = self.observed[rows].sum(0)
        return np.where((total > 0) & (observed > 0), observed / np.where(total > 0, total, 1), 1.0)

    def squared_distance(self, residual: Float64[np.ndarray, "*n cameras"]) -> Float64[np.ndarray, "*n"]:
        """r^T K^-1 r."""
        return ((residual @ self.precision) * residual).sum(-1)


def log_likelihood(distance: np.ndarray, variance: np.ndarray, rows: int) -> np.ndarray:
    """Of frames by Student's t with `DEGREES`, up to a constant that all hypotheses share.

    Args:
        distance: r^T K^-1 r of each frame.
        variance: v of each frame.
        rows: entries of r.
    """
    return -0.5 * (rows * np.log(variance) + (DEGREES + rows) * np.log1p(distance / (DEGREES * variance)))


def _correlation(directions: np.ndarray, concentration: float, own_share: float) -> np.ndarray:
    cosines = np.clip(directions @ directions.T, -1, 1)
    return (1 - own_share) * np.exp(concentration * (cosines - 1)) + own_share * np.eye(len(directions))


def directions_from(center: np.ndarray, positions: np.ndarray) -> Float64[np.ndarray, "n 3"]:
    """Unit vectors from a point to others."""
    return unit_or(positions - center, 0.0)
