"""PSNR, SSIM and FLIP against analytic answers, and against ways to flatter them."""

from __future__ import annotations

import math

import flip_evaluator
import numpy as np
import pytest

from pipeline.metrics.images import flip, foreground_box, psnr_db, ssim


def noise_image(seed: int = 0, height: int = 40, width: int = 30) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, 1, (height, width, 3)).astype(np.float32)


@pytest.mark.parametrize("difference", [0.5, 0.1, 0.01])
def test_psnr_of_a_constant_difference(difference):
    captured = np.full((8, 9, 3), 0.4)
    everywhere = np.ones((8, 9), bool)
    # mean square = difference^2, so PSNR = -20 log10(difference)
    assert psnr_db(captured + difference, captured, everywhere) == pytest.approx(-20 * math.log10(difference), abs=1e-9)


def test_psnr_counts_the_foreground_only():
    captured, rendered = np.zeros((10, 10, 3)), np.zeros((10, 10, 3))
    foreground = np.zeros((10, 10), bool)
    foreground[:2, :5] = True
    rendered[foreground] = 0.1
    assert psnr_db(rendered, captured, foreground) == pytest.approx(20.0)
    rendered[~foreground] = 1.0
    assert psnr_db(rendered, captured, foreground) == pytest.approx(20.0)


def test_psnr_of_equal_images_is_infinite_and_of_no_foreground_undefined():
    image = noise_image()
    assert psnr_db(image, image, np.ones(image.shape[:2], bool)) == math.inf
    assert math.isnan(psnr_db(image, image, np.zeros(image.shape[:2], bool)))


def test_ssim_of_equal_images_is_one_and_of_inverted_ones_negative():
    image = noise_image()
    assert ssim(image, image) == pytest.approx(1.0, abs=1e-12)
    assert ssim(1 - image, image) < -0.5
    assert math.isnan(ssim(image[:10], image[:10]))


def test_ssim_of_two_flat_images_is_the_luminance_term():
    # No variance: SSIM = (2 a b + C1) / (a^2 + b^2 + C1), C1 = (0.01 * data range)^2 (Wang et al. 2004, eq. 6).
    a, b, c1 = 0.3, 0.6, 0.01**2
    found = ssim(np.full((20, 20, 3), a), np.full((20, 20, 3), b))
    assert found == pytest.approx((2 * a * b + c1) / (a * a + b * b + c1), abs=1e-9)


def test_flip_is_zero_for_equal_images_one_sided_and_grows_with_the_error():
    image = noise_image() * 0.5
    assert flip(image, image) == pytest.approx(0.0, abs=1e-6)
    small, large = flip(image + 0.02, image), flip(image + 0.3, image)
    assert 0 < small < large < 1
    # Green against blue is FLIP's own largest colour difference: its error map is 1 there.
    green, blue = np.zeros((64, 64, 3), np.float32), np.zeros((64, 64, 3), np.float32)
    green[..., 1], blue[..., 2] = 1, 1
    assert flip(green, blue) > 0.95


def test_foreground_box():
    foreground = np.zeros((20, 30), bool)
    assert foreground_box(foreground) == (slice(0, 20), slice(0, 30))
    foreground[3:6, 28:30] = True
    assert foreground_box(foreground) == (slice(3, 6), slice(28, 30))
    rows, columns = foreground_box(foreground, 11)
    assert (rows.start <= 3, rows.stop >= 6, rows.stop - rows.start) == (True, True, 11)
    assert (columns.stop, columns.stop - columns.start) == (30, 11)
    rows, columns = foreground_box(foreground, 100)
    assert (rows, columns) == (slice(0, 20), slice(0, 30))


def test_flip_is_that_of_its_authors_for_their_own_viewing_distance():
    """0.7 m from a screen of 3840 pixels and 0.7 m: 67.02 pixels per degree, which we call 67."""
    reference, test = noise_image(1, 64, 64).repeat(2, 0), noise_image(2, 64, 64).repeat(2, 0)
    expected = flip_evaluator.evaluate(reference, test, "LDR", True, False)[1]
    assert flip(test, reference) == pytest.approx(expected, rel=2e-3)
