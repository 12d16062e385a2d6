"""Errors of colours and intensities against those of repeated draws."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.calibration.lights.light_intensity import Brightness, compare_lights, relative_colors

DRAWS = 20000
"""Which know a standard deviation to 0.5 %."""


def test_error_of_a_colour_is_that_of_repeated_draws():
    """Channels share their sum: the larger a channel's part, the less its own error moves its share."""
    rng = np.random.default_rng(3)
    value, relative = np.array([5.0, 2.0, 0.5]), np.array([0.02, 0.01, 0.03])
    drawn = value * (1 + relative * rng.normal(size=(DRAWS, 3)))
    spread = (3 * drawn / drawn.sum(1, keepdims=True)).std(0)
    found = relative_colors(Brightness(value[None], (value * relative)[None]))
    assert found.value[0] == pytest.approx(3 * value / value.sum())
    assert found.sigma[0] == pytest.approx(spread, rel=0.03)


def test_brightness_is_flux_over_the_balls_curvature_there():
    """The same lamp, seen near the rim, covers a smaller part of the image and is as bright."""
    light, camera = np.repeat(np.arange(3), 8), np.tile(np.arange(2), 12)
    spread = np.random.default_rng(5).uniform(2, 60, 24)
    power = np.array([1.0, 2.0, 4.0])
    found = compare_lights(light, camera, (power[light] * spread)[:, None], spread, 3)
    assert found.value[:, 0] == pytest.approx(power / 2, rel=1e-6)
