"""Charts of other patches than the classic ones: placed, measured and fitted, whichever way they were held."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pipeline.calibration.color.chart_layout import CLASSIC, ChartLayout, grid_layout
from pipeline.calibration.color.color_chart import measure_patches, place_chart
from pipeline.calibration.color.color_response import fit_response
from tests.support.drawings.chart import RESPONSE

CELL = 24
"""Pixels of a patch with its gap in the drawing."""

BLOCKS = ChartLayout(
    np.array([[column + 0.4 * (column > 3), row] for row in range(6) for column in range(8)], np.float64)
)
"""Two blocks of 4 x 6 side by side, as SpyderCheckr has them."""

LAYOUTS = {"two blocks": BLOCKS, "10 x 14": grid_layout(10, 14), "classic": CLASSIC}


def values_of(layout):
    return np.random.default_rng(layout.patches).uniform(0.02, 0.9, (layout.patches, 3))


def photograph(layout, raw):
    """The chart drawn flat, 0.85 of each cell, and seen askew; its outer corners in the image."""
    columns, rows = layout.extent
    size = (round((columns + 1.15) * CELL), round((rows + 1.15) * CELL))
    flat = np.full((size[1], size[0], 3), 0.01, np.float32)
    for (column, row), color in zip(layout.places, raw, strict=True):
        left, top = round((column + 0.15) * CELL), round((row + 0.15) * CELL)
        flat[top : top + round(0.85 * CELL), left : left + round(0.85 * CELL)] = color
    corners = np.array([[0.15, 0.15], [columns + 1, 0.15], [columns + 1, rows + 1], [0.15, rows + 1]]) * CELL
    to_image = cv2.getPerspectiveTransform(
        np.array([[0, 0], [size[0], 0], [size[0], size[1]], [0, size[1]]], np.float32),
        np.array([[30, 20], [470, 40], [450, 330], [10, 350]], np.float32),
    )
    image = cv2.warpPerspective(flat, to_image, (500, 370))
    return image, cv2.perspectiveTransform(corners[None], to_image)[0]


@pytest.mark.parametrize("name", LAYOUTS)
@pytest.mark.parametrize("turned", [False, True])
def test_response_is_found_on_any_chart_either_way_up(name, turned):
    layout = LAYOUTS[name]
    values = values_of(layout)
    image, corners = photograph(layout, (values @ RESPONSE.T).astype(np.float32))
    if turned:
        corners = np.roll(corners, 2, axis=0)
    squares = place_chart(corners, layout)
    patches = measure_patches(image, np.zeros(image.shape[:2], bool), squares, 0.6, layout)
    assert patches.used.all() and not patches.mirrored()
    response = fit_response(patches, values)
    # Nothing but the patches' colour in the middle of each: float32, and medians of it.
    np.testing.assert_allclose(response.matrix, RESPONSE, atol=2e-3)


def test_classic_chart_is_told_from_another_of_24():
    assert CLASSIC.is_classic and grid_layout(4, 6).is_classic
    assert not grid_layout(6, 4).is_classic and not BLOCKS.is_classic
    assert ChartLayout.from_index({}) is CLASSIC


def test_orders_are_those_that_the_outline_allows():
    assert [len(layout.orders) for layout in LAYOUTS.values()] == [4, 4, 4]
    lopsided = ChartLayout(np.array([[0, 0], [1, 0], [2.5, 0], [0, 1], [1, 1], [2.5, 1]], np.float64))
    assert [order.tolist() for order in lopsided.orders] == [[0, 1, 2, 3, 4, 5], [3, 4, 5, 0, 1, 2]]
