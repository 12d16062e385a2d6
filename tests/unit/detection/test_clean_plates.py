"""Masks by clean plates, on scenes where the subject was put in by the test."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.detection.clean_plates import DIFFERENT, mask_by_plate, measure_noise

HEIGHT, WIDTH, NOISE = 120, 160, 0.004
STEP = 1 / 65535


def scene(stage, seed, subject=None, colour=(0.4, 0.25, 0.2), noise=NOISE):
    """A photograph of the stage: level [h, w], a subject in front of it, Gaussian noise."""
    image = np.repeat(stage[..., None], 3, 2).astype(np.float64)
    if subject is not None:
        image[subject] = colour
    return (image + np.random.default_rng(seed).normal(0, noise, image.shape)).astype(np.float32)


def disc(radius=30.0):
    rows, columns = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    return (rows - 60) ** 2 + (columns - 80) ** 2 < radius**2


def stages():
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    wires = 0.3 * (columns % 23 < 3) + 0.1 * (rows % 17 < 2)
    return {"black": np.zeros((HEIGHT, WIDTH)), "grey": 0.1 + 0.2 * columns / WIDTH, "wires": 0.05 + wires}


@pytest.mark.parametrize("name", stages())
def test_subject_is_masked_to_a_pixel_and_nothing_else(name):
    stage, truth = stages()[name], disc()
    plate = scene(stage, 1)
    mask = mask_by_plate(scene(stage, 2, truth), plate, measure_noise(plate), STEP) > 0
    wrong = mask != truth
    rows, columns = np.nonzero(wrong)
    # Of the outline alone: a pixel that lies within 1.5 of it.
    assert (np.abs(np.hypot(rows - 59.5, columns - 79.5) - 30) < 1.5).all()
    # A shift of the outline by half a pixel changes 2 pi 30 / 2 = 94 pixels.
    assert wrong.sum() < 94


@pytest.mark.parametrize("name", stages())
def test_empty_stage_has_no_subject(name):
    stage = stages()[name]
    plate = scene(stage, 3)
    assert not mask_by_plate(scene(stage, 4), plate, measure_noise(plate), STEP).any()


def test_hole_as_black_as_the_stage_is_filled():
    body = disc() & ~disc(8.0)
    plate = scene(stages()["black"], 5)
    mask = mask_by_plate(scene(stages()["black"], 6, body), plate, measure_noise(plate), STEP)
    assert (mask[disc(28.0)] == 255).all()


def test_noise_is_what_was_planted_at_each_brightness():
    level = np.repeat(np.linspace(0, 1, 400)[None], 400, 0)
    deviation = 0.002 + 0.01 * level
    random = np.random.default_rng(7).normal(size=(400, 400, 3))
    plate = (level[..., None] + deviation[..., None] * random).astype(np.float32)
    measured = measure_noise(plate).at(np.repeat(level[..., None], 3, 2).astype(np.float32))[0, 40:360]
    # 10,000 pixels each: 1.2 % from the median absolute deviation, and the 2 % of what it assumes.
    np.testing.assert_allclose(measured, np.repeat(deviation[0, 40:360, None], 3, 1), rtol=0.06)


def test_file_without_noise_is_as_uncertain_as_its_last_digit():
    """Plate and image differ by one stored step: no subject. By `DIFFERENT` deviations of a mean of nine: one."""
    plate = np.full((HEIGHT, WIDTH, 3), 0.25, np.float32)
    noise = measure_noise(plate)
    assert not mask_by_plate(plate + np.float32(STEP), plate, noise, STEP).any()
    clear = DIFFERENT * STEP * np.sqrt(2 / 27) * 1.1
    image = np.where(disc()[..., None], plate + np.float32(clear), plate).astype(np.float32)
    assert mask_by_plate(image, plate, noise, STEP)[60, 80] == 255
