"""Over- and underexposure by the levels of images whose clipping and rounding is planted."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from pipeline.sync.stored_levels import CLIPPED_WEAK, COARSE_WEAK, LEVELS, level_flaws, stored_levels


def radiance(seed: int) -> np.ndarray:
    """Gray pixels of a median of 0.2, three in a thousand above 1."""
    return np.random.default_rng(seed).lognormal(np.log(0.2), 0.6, (20_000, 1)) * np.ones(3)


def table(images: list[np.ndarray]) -> pd.DataFrame:
    rows = [(*pixels.mean(0), *stored_levels(pixels.astype(np.float32))) for pixels in images]
    return pd.DataFrame(rows, columns=["r", "g", "b", *LEVELS])


@pytest.mark.parametrize("levels", [255, 65535])
def test_a_plateau_is_the_share_that_is_clipped(levels):
    light = radiance(0) * 3
    stored = np.round(np.minimum(light, 1) * levels) / levels
    top, plateau, step = stored_levels(stored.astype(np.float32))
    assert top == 1.0
    # Less those that the next lower level holds: a level of a byte has one pixel in 200 here.
    assert plateau == pytest.approx((light[:, 0] >= 1).mean(), abs=0.005)
    # Of as many levels as there are pixels that are looked at, neighbours are not seen: the distance is no smaller.
    distance = step * np.median(stored)
    assert 0.99 / levels < distance < (1.5 / levels if levels == 255 else 1e-3)


def test_floats_that_reach_no_end_have_no_plateau():
    assert stored_levels(radiance(1).astype(np.float32))[1] <= 1 / 20_000


def test_thresholds_are_those_of_35_decibels():
    """Of clipped pixels that lack half a stop, and of rounding at a mid grey of 0.18, both in sRGB."""
    wrong = 1.055 * (2**0.5) ** (1 / 2.4) - 0.055 - 1
    assert -10 * np.log10(CLIPPED_WEAK * wrong**2) == pytest.approx(35, abs=0.2)
    slope = 1.055 / 2.4 * 0.18 ** (1 / 2.4 - 1)
    assert -10 * np.log10((COARSE_WEAK * 0.18 * slope) ** 2 / 12) == pytest.approx(35, abs=0.2)


@pytest.mark.parametrize(
    ("gain", "grades"), [(0.9, []), (1.5, ["weak"]), (6.0, ["failed"]), (0.04, ["weak"]), (0.008, ["failed"])]
)
def test_images_of_eight_bits_are_judged_by_their_exposure(gain, grades):
    images = [np.round(np.minimum(gain * radiance(k), 1) * 255) / 255 for k in range(4)]
    assert [grade for grade, _ in level_flaws(table(images))] == grades


def test_a_bright_image_of_one_value_is_not_clipped_where_others_are_brighter():
    flat = [np.full((500, 3), value) for value in (0.2, 0.4, 0.7)]
    assert level_flaws(table(flat)) == []


def test_a_lens_cap_is_underexposed():
    ((grade, why),) = level_flaws(table([np.zeros((500, 3))] * 2))
    assert grade == "failed" and "underexposed" in why
