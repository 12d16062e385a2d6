"""Spots in drawn and photographed balls: against the mirror law, and against published directions."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.photographed_targets import angles_deg, probe_directions, published_directions
from pipeline.calibration.lights.ball_highlights import measure_spots
from tests.support.shared_data import shared_data

SIZE = 320
PSBOX, needs_psbox = shared_data("data/mirrorball_psbox/LightProbe-1")


def circle(center, radius):
    angle = np.linspace(0, 2 * np.pi, 360, endpoint=False)[:, None]
    return np.asarray(center) + radius * np.concatenate([np.cos(angle), np.sin(angle)], 1)


def draw(spots, middle=(160.3, 158.8), radius=50.0, emitter=0.05, oversampling=8):
    """A dark ball far away that mirrors far round lamps: (angle off the view axis, roll, brightness) each.

    A pixel at p sees the direction 2 (n . e) n - e with n = (p, sqrt(1 - p^2)): counting samples draws the lamps.
    """
    steps = (np.arange(oversampling * SIZE) + 0.5) / oversampling
    x, y = np.meshgrid((steps - middle[0]) / radius, (steps - middle[1]) / radius)
    z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    image = np.full(x.shape, 0.01)
    for angle, roll, brightness in spots:
        lamp = np.array([np.sin(angle) * np.cos(roll), np.sin(angle) * np.sin(roll), np.cos(angle)])
        away = 2 * z * (x * lamp[0] + y * lamp[1] + z * lamp[2]) - lamp[2]
        image[(away > np.cos(emitter)) & (z > 0)] = brightness
    image = image.reshape(SIZE, oversampling, SIZE, oversampling).mean((1, 3))
    return image[..., None].astype(np.float32), circle(middle, radius)


def expected(angle, roll, middle=(160.3, 158.8), radius=50.0):
    """Half the angle is that of the normal."""
    return np.asarray(middle) + radius * np.sin(angle / 2) * np.array([np.cos(roll), np.sin(roll)])


def unclipped(image):
    return np.zeros(image.shape[:2], bool)


@pytest.mark.parametrize("off_axis", [20.0, 80.0, 120.0, 155.0])
def test_place_and_distance_of_a_spot(off_axis):
    angle, roll = np.radians(off_axis), 0.7
    image, outline = draw([(angle, roll, 0.9)])
    image += np.random.default_rng(0).normal(0, 0.002, image.shape).astype(np.float32)
    (spot,) = measure_spots(image, unclipped(image), outline)
    # One to two pixels wide, so its pixels' shares place it to a small part of one.
    assert np.linalg.norm(spot.pixel - expected(angle, roll)) < 0.1
    assert spot.distance == pytest.approx(np.sin(angle / 2), abs=0.01)


def test_a_dark_ball_has_no_spot():
    noise = np.random.default_rng(0).normal(0.01, 0.003, (SIZE, SIZE, 1)).astype(np.float32)
    assert measure_spots(noise, unclipped(noise), circle((160, 160), 50)) == []


def test_two_lamps_are_two_spots_brightest_first():
    image, outline = draw([(0.5, 0.3, 0.3), (1.2, 2.5, 0.8)])
    bright, faint = measure_spots(image, unclipped(image), outline)
    assert np.linalg.norm(bright.pixel - expected(1.2, 2.5)) < 0.1
    assert np.linalg.norm(faint.pixel - expected(0.5, 0.3)) < 0.1


def test_a_mirror_ball_is_an_even_map():
    """A far lamp of solid angle w and brightness b covers (radius / 2)^2 w pixels, in whatever direction."""
    for angle in (0.2, 1.0, 1.8):
        image, outline = draw([(angle, 1.1, 0.8)])
        (spot,) = measure_spots(image, unclipped(image), outline)
        solid_angle = 2 * np.pi * (1 - np.cos(0.05))
        assert spot.flux == pytest.approx([0.79 * 25**2 * solid_angle], rel=0.03)


def test_clipped_pixels_are_told():
    image, outline = draw([(0.8, 0.3, 1.5)])
    clipped = image[..., 0] >= 0.98
    (spot,) = measure_spots(np.minimum(image, 1), clipped, outline)
    assert spot.saturated


@needs_psbox
def test_published_directions_of_psbox():
    """Twelve photographs of one ball: JPEG, sRGB, clipped highlights with streaks. Orthographic, as PSBox has it.

    They take the median of all pixels at 250 or more, their own reading of the same highlights.
    """
    error = angles_deg(probe_directions(PSBOX), published_directions())
    assert error.mean() < 0.35
    assert error.max() < 0.5
