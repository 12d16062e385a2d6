"""Finding and measuring a 24-patch chart, drawn or photographed."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.photographed_targets import find_labelled_chart
from pipeline.calibration.color.color_chart import find_chart, measure_patches, place_chart
from tests.support.drawings.chart import RESPONSE, VALUES, chart_pixels, corners_of_chart, draw_chart
from tests.support.shared_data import shared_data

CHARTS, needs_charts = shared_data("data/chart_photographs")

MIDDLES = chart_pixels(*[(column + 0.5, row + 0.5) for row in range(4) for column in range(6)])
NOTHING_SATURATED = np.zeros((400, 560), bool)


def test_the_detector_finds_every_patch():
    squares = find_chart(draw_chart())
    # Patches reach 16 pixels and more from their middles, what is measured of them 12: 4 off leaves all of it inside.
    assert squares.mean(1) == pytest.approx(MIDDLES, abs=4)


def test_given_corners_place_every_patch():
    squares = place_chart(corners_of_chart())
    # The drawn chart's gaps are wider than the model's: off by up to 0.03 of 50 pixels.
    assert squares.mean(1) == pytest.approx(MIDDLES, abs=1.5)
    patches = measure_patches(draw_chart(), NOTHING_SATURATED, squares, 0.8)
    assert patches.used.all()
    assert not patches.mirrored()
    # Median of about 300 pixels of 0.003: 2e-4; five of them.
    assert patches.color == pytest.approx(VALUES @ RESPONSE.T, abs=1e-3)


def test_corners_counted_the_other_way_round_are_a_mirror():
    patches = measure_patches(draw_chart(), NOTHING_SATURATED, place_chart(corners_of_chart()[[1, 0, 3, 2]]), 0.8)
    assert patches.mirrored()
    assert patches.color[0] == pytest.approx(VALUES[5] @ RESPONSE.T, abs=1e-3)


def test_no_chart_is_none():
    assert find_chart(np.full((200, 300, 3), 0.1, np.float32)) is None


def test_a_patch_with_some_saturated_pixels_is_left_out():
    saturated = NOTHING_SATURATED.copy()
    column, row = MIDDLES[18].astype(int)
    saturated[row - 2 : row + 2, column - 2 : column + 2] = True
    patches = measure_patches(draw_chart(), saturated, place_chart(corners_of_chart()), 0.8)
    assert not patches.used[18]
    assert np.isnan(patches.color[18]).all()
    assert patches.used.sum() == 23


def test_a_chart_too_small_is_not_measured():
    squares = place_chart(corners_of_chart() / 10)
    assert not measure_patches(draw_chart(), NOTHING_SATURATED, squares, 0.8).used.any()


@needs_charts
def test_a_photographed_chart_is_found_where_its_labels_are():
    """Each square's middle and its four corners lie on the patch of that number, by the published outlines."""
    assert find_labelled_chart(CHARTS).inside == 24
