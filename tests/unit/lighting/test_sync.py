"""Planted offsets are found; captures whose timing cannot be judged never raise an alarm."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest

from pipeline.lighting.sync import IN_SYNC, OUT_OF_SYNC, UNDETERMINED, check_sync

FRAMES = 48
MARGIN = 10
SHADING = 0.08
"""Spread of observed / predicted brightness: what shading and shadows do to an average over cameras."""


def flashing(rng: np.random.Generator, count: int) -> np.ndarray:
    """Every third frame fully lit, the others a few random lights of about the same total power."""
    return np.where(np.arange(count) % 3 == 0, 1.0, rng.uniform(0.5, 1.3, count))


def single_lights(rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.uniform(0.2, 1.0, count)


def constant(rng: np.random.Generator, count: int) -> np.ndarray:
    # A sum over many lights in another order differs in its last bits.
    return 21.76 + rng.integers(-2, 3, count) * np.spacing(21.76)


def flicker(rng: np.random.Generator, count: int) -> np.ndarray:
    return 1 + 1e-3 * rng.normal(size=count)


def drifting(rng: np.random.Generator, count: int) -> np.ndarray:
    return 1 + 0.3 * np.sin(np.arange(count) / count * 2 * np.pi + rng.uniform(0, 6))


def one_step(rng: np.random.Generator, count: int) -> np.ndarray:
    return np.where(np.arange(count) < count * rng.uniform(0.2, 0.8), 1.0, 0.2)


def alternating(rng: np.random.Generator, count: int) -> np.ndarray:
    return np.where(np.arange(count) % 2 == 0, 1.0, 0.3)


def stage(pattern, seed: int, fault: int = 0) -> tuple[pd.Series, pd.Series]:
    """(predicted, observed) of a subject that turns slowly; images of frame f show the pattern logged for f + fault."""
    rng = np.random.default_rng(seed)
    truth = pattern(rng, FRAMES + 2 * MARGIN)
    turning = 1 + 0.02 * np.cumsum(rng.normal(size=FRAMES))
    shading = 1 + SHADING * rng.normal(size=FRAMES)
    shown = truth[MARGIN + fault : MARGIN + fault + FRAMES]
    index = np.arange(100, 100 + FRAMES)
    return pd.Series(truth[MARGIN : MARGIN + FRAMES], index), pd.Series(0.3 * shown * turning * shading, index)


@pytest.mark.parametrize("fault", [-5, -4, -3, -2, -1, 1, 2, 3, 4, 5])
@pytest.mark.parametrize("pattern", [flashing, single_lights])
def test_planted_offsets_are_found(pattern, fault):
    for seed in range(5):
        found = check_sync(*stage(pattern, seed, fault))
        assert (found.offset_frames, found.verdict) == (fault, OUT_OF_SYNC), found.why
        assert found.correlation == max(found.correlations.values())
        assert len(found.correlations) == 11


@pytest.mark.parametrize("pattern", [flashing, single_lights])
def test_a_good_stage_is_in_sync(pattern):
    for seed in range(20):
        found = check_sync(*stage(pattern, seed))
        assert (found.offset_frames, found.verdict) == (0, IN_SYNC), found.why


@pytest.mark.parametrize("pattern", [constant, flicker, drifting, one_step, alternating])
def test_patterns_that_say_little_raise_no_false_alarm(pattern):
    for seed in range(20):
        found = check_sync(*stage(pattern, seed))
        assert found.verdict != OUT_OF_SYNC, found.why
        assert found.offset_frames == 0


def test_a_constant_pattern_is_undetermined():
    for seed in range(20):
        found = check_sync(*stage(constant, seed))
        assert found.verdict == UNDETERMINED
        assert math.isnan(found.correlation)


def test_images_that_ignore_the_pattern_are_undetermined():
    for seed in range(20):
        predicted, _ = stage(flashing, seed)
        _, observed = stage(single_lights, seed + 1000)
        assert check_sync(predicted, observed).verdict == UNDETERMINED


def test_an_offset_that_predicts_the_same_is_not_better():
    predicted, observed = stage(alternating, 0)
    found = check_sync(predicted, observed)
    assert found.verdict == IN_SYNC
    assert found.correlations[2] == pytest.approx(found.correlations[0], abs=0.05)


def test_gaps_between_frames_and_missing_images():
    predicted, observed = stage(single_lights, 3, fault=2)
    observed.iloc[[4, 20]] = np.nan
    keep = np.r_[0:15, 22:FRAMES]
    assert check_sync(predicted, observed.iloc[keep]).offset_frames == 2


def test_few_frames_say_nothing():
    predicted, observed = stage(single_lights, 0)
    assert check_sync(predicted[:8], observed[:8]).verdict == UNDETERMINED
    assert check_sync(predicted * 0, observed).verdict == UNDETERMINED
    assert check_sync(predicted, observed * 0).verdict == UNDETERMINED
