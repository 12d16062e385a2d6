"""How often chance passes for an effect, and a planted effect is found: drawn scores whose truth is known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import nct, ttest_1samp
from scipy.stats import t as student

from pipeline.metrics.significance import (
    BLOCKS,
    Estimate,
    frame_blocks,
    holm,
    mean_over_images,
    over_new_subjects,
    over_these_subjects,
)

LEVEL = 0.05
DRAWS = 2000
CHANCE = 4 * math.sqrt(LEVEL * (1 - LEVEL) / DRAWS)
"""Four standard deviations of the share of rejections among `DRAWS` draws."""


def held_out_frames(frames: int) -> np.ndarray:
    """As in a capture: two test cameras see every frame, eight cameras every fourth."""
    return np.sort(np.concatenate([np.repeat(np.arange(frames), 2), np.repeat(np.arange(0, frames, 4), 6)]))


def differences(rng: np.random.Generator, frame: np.ndarray, effect: float = 0.0, memory: float = 0.0) -> np.ndarray:
    """effect + what a frame's images share, an AR(1) process of unit spread and correlation `memory`, + noise.

    Frames of the second half vary three times as much.
    """
    count = frame.max() + 1
    shared = np.empty(count)
    shared[0] = rng.standard_normal()
    for k in range(1, count):
        shared[k] = memory * shared[k - 1] + math.sqrt(1 - memory**2) * rng.standard_normal()
    spread = np.where(np.arange(count) < count // 2, 1.0, 3.0)
    return effect + (spread * shared)[frame] + 0.5 * rng.standard_normal(len(frame))


@pytest.mark.parametrize("frames", [24, 96])
def test_without_an_effect_at_most_five_percent_are_found(frames):
    """Images of a frame correlate; the test per image, which most papers would do, finds effects far too often."""
    rng, frame = np.random.default_rng(0), held_out_frames(frames)
    drawn = [differences(rng, frame) for _ in range(DRAWS)]
    found = np.mean([mean_over_images(d, frame).p_value < LEVEL for d in drawn])
    naive = np.mean(ttest_1samp(np.stack(drawn), 0, axis=1).pvalue < LEVEL)
    assert found < LEVEL + CHANCE
    assert naive > 4 * LEVEL


def share_found(frame: np.ndarray, memory: float) -> float:
    """Share of draws without an effect in which the blocks' test finds one, exactly.

    It does if m^2 > c^2 B / (B - 1) sum (u_b / n)^2: if a quadratic form of normal numbers is positive, whose
    distribution Imhof (1961, "Computing the distribution of quadratic forms in normal variables", eq. 3.2) integrates.
    """
    count, images = frame.max() + 1, len(frame)
    spread = np.where(np.arange(count) < count // 2, 1.0, 3.0)
    apart = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    shared = spread[:, None] * np.where(apart == 0, 1.0, memory**apart) * spread
    covariance = shared[np.ix_(frame, frame)] + 0.25 * np.eye(images)
    sums = np.eye(BLOCKS)[:, frame_blocks(frame)] @ (np.eye(images) - 1 / images)
    critical = student.isf(LEVEL / 2, BLOCKS - 1)
    form = np.full((images, images), 1.0) - critical**2 * BLOCKS / (BLOCKS - 1) * sums.T @ sums
    weights = np.linalg.eigvals(form @ covariance).real
    weights = weights[np.abs(weights) > 1e-9 * np.abs(weights).max()] / np.abs(weights).max()

    def integrand(u: float) -> float:
        turn = 0.5 * np.arctan(weights * u).sum()
        return math.sin(turn) / u * math.exp(-0.25 * np.log1p((weights * u) ** 2).sum())

    return 0.5 + quad(integrand, 0, np.inf, limit=500)[0] / math.pi


@pytest.mark.parametrize(("frames", "memory"), [(24, 0.0), (24, 0.5), (48, 0.5)])
def test_chance_passes_for_an_effect_as_often_as_theory_says(frames, memory):
    """Neighbours that are correlated by 0.5 fool a test per frame; blocks of three of them are still a little alike."""
    rng, frame = np.random.default_rng(1), held_out_frames(frames)
    drawn = [differences(rng, frame, memory=memory) for _ in range(DRAWS)]
    found = np.mean([mean_over_images(d, frame).p_value < LEVEL for d in drawn])
    exact = share_found(frame, memory)
    assert found == pytest.approx(exact, abs=4 * math.sqrt(exact * (1 - exact) / DRAWS))
    assert exact < (LEVEL if memory == 0 else 2 * LEVEL)
    if memory:
        per_frame = np.stack([np.bincount(frame, d) for d in drawn]) / np.bincount(frame)
        assert np.mean(ttest_1samp(per_frame, 0, axis=1).pvalue < LEVEL) > 3 * LEVEL


def test_a_known_difference_is_found_as_often_as_theory_says():
    """Equal blocks of independent normal frames: the power is that of the noncentral t distribution."""
    rng, frame, effect = np.random.default_rng(2), np.repeat(np.arange(4 * BLOCKS), 3), 0.5
    shared = rng.standard_normal((DRAWS, 4 * BLOCKS))[:, frame]
    found = np.mean([mean_over_images(effect + d, frame).p_value < LEVEL for d in shared])
    degrees, shift = BLOCKS - 1, effect * math.sqrt(4 * BLOCKS)
    critical = student.isf(LEVEL / 2, degrees)
    power = nct.sf(critical, degrees, shift) + nct.cdf(-critical, degrees, shift)
    assert 0.6 < power < 0.8
    assert found == pytest.approx(power, abs=4 * math.sqrt(power * (1 - power) / DRAWS))


@pytest.mark.parametrize("subjects", [2, 3])
def test_subjects_share_no_frames_so_together_they_say_more(subjects):
    rng, frame = np.random.default_rng(3), held_out_frames(24)

    def found(effect: float) -> tuple[float, float]:
        together, alone = 0, 0
        for _ in range(DRAWS // 2):
            estimates = [mean_over_images(differences(rng, frame, effect), frame) for _ in range(subjects)]
            together += over_these_subjects(estimates).p_value < LEVEL
            alone += estimates[0].p_value < LEVEL
        return together / (DRAWS // 2), alone / (DRAWS // 2)

    assert found(0.0)[0] < LEVEL + math.sqrt(2) * CHANCE
    together, alone = found(1.0)
    assert together > alone + 0.1


def test_subjects_that_disagree_say_little_of_new_ones():
    """Each subject has an effect of its own, of mean zero, far above its frames' noise."""
    rng, frame, draws = np.random.default_rng(4), held_out_frames(24), DRAWS // 2
    these = new = 0
    for _ in range(draws):
        effects = 5 * rng.standard_normal(4)
        estimates = [mean_over_images(differences(rng, frame, effect), frame) for effect in effects]
        these += over_these_subjects(estimates).p_value < LEVEL
        new += over_new_subjects(estimates).p_value < LEVEL
    assert new / draws < LEVEL + math.sqrt(2) * CHANCE
    assert these / draws > 0.5  # rightly: these four subjects do differ


def test_error_of_equal_blocks_is_that_of_their_means():
    frame = np.repeat(np.arange(BLOCKS), 5)
    value = np.random.default_rng(5).standard_normal(len(frame))
    means = value.reshape(BLOCKS, 5).mean(1)
    estimate = mean_over_images(value, frame)
    assert estimate.mean == pytest.approx(value.mean(), abs=1e-15)
    assert estimate.error == pytest.approx(means.std(ddof=1) / math.sqrt(BLOCKS), rel=1e-12)
    assert estimate.p_value == pytest.approx(ttest_1samp(means, 0).pvalue, rel=1e-10)


def test_blocks_are_runs_of_frames_with_about_equally_many_images():
    frame = held_out_frames(96)
    block = frame_blocks(frame)
    assert (np.diff(block) >= 0).all()
    assert all(len(set(block[frame == f])) == 1 for f in range(96))
    images = np.bincount(block)
    assert len(images) == BLOCKS and images.max() - images.min() <= 8  # a frame has 2 or 8 images
    assert len(set(frame_blocks(np.array([7, 7, 9, 9, 9])))) == 2


def test_estimates_without_anything_to_go_by_say_so():
    one = mean_over_images(np.array([1.0, 2.0]), np.array([3, 3]))
    assert one.mean == 1.5 and math.isnan(one.error) and math.isnan(one.p_value)
    assert math.isnan(mean_over_images(np.zeros(0), np.zeros(0, int)).mean)
    assert math.isnan(over_new_subjects([Estimate(1.0, 0.1, 7.0)]).p_value)
    assert math.isnan(over_these_subjects([Estimate(1.0, 0.1, 7.0), one]).p_value)
    same = mean_over_images(np.zeros(6), np.arange(6))
    assert same.p_value == 1 and over_these_subjects([same, same]).p_value == 1


def test_joint_degrees_lie_between_those_of_one_subject_and_of_all():
    equal = over_these_subjects([Estimate(0.0, 1.0, 7.0), Estimate(2.0, 1.0, 7.0)])
    assert (equal.mean, equal.error, equal.degrees) == pytest.approx((1.0, math.sqrt(2) / 2, 14))
    assert over_these_subjects([Estimate(0.0, 1.0, 7.0), Estimate(2.0, 1e-6, 7.0)]).degrees == pytest.approx(7)


def test_holm_by_hand():
    corrected = holm(np.array([0.04, 0.01, np.nan, 0.03, 0.5]))
    np.testing.assert_allclose(corrected, [0.09, 0.04, np.nan, 0.09, 0.5], rtol=1e-12)
    assert holm(np.array([0.6, 0.7]))[0] == 1


def test_holm_keeps_the_chance_of_any_false_find():
    """Six tests on the same frames, correlated: uncorrected, one in six would be found; corrected, one in twenty."""
    rng, frame = np.random.default_rng(6), held_out_frames(24)
    any_plain = any_holm = 0
    for _ in range(DRAWS // 2):
        p = np.array([mean_over_images(differences(rng, frame), frame).p_value for _ in range(6)])
        any_plain += (p < LEVEL).any()
        any_holm += (holm(p) < LEVEL).any()
    assert any_holm / (DRAWS // 2) < LEVEL + math.sqrt(2) * CHANCE
    assert any_plain / (DRAWS // 2) > 3 * LEVEL


@pytest.mark.parametrize("subjects", [2, 3, 7])
def test_of_new_subjects_a_t_test_of_the_means_decides(subjects):
    means = np.random.default_rng(subjects).normal(0.3, 1, subjects)
    found = over_new_subjects([Estimate(mean, 0.1, 7.0) for mean in means])
    assert found.p_value == pytest.approx(ttest_1samp(means, 0).pvalue, rel=1e-9)
    assert found.mean == pytest.approx(means.mean())
