"""Pictures of captured, rendered and error come apart again as they were put together."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.metrics.comparison import ENLARGE, SMALL_SIDE, heat_css, preview_srgb, side_by_side, split_picture


@pytest.mark.parametrize("height", [40, SMALL_SIDE - 1, SMALL_SIDE])
def test_split_picture_gives_back_the_scored_pixels(height):
    rng = np.random.default_rng(0)
    captured, rendered = rng.random((2, height, 31, 3)).astype(np.float32)
    parts = split_picture(side_by_side(captured, rendered, "label"))
    np.testing.assert_array_equal(parts["captured"], np.round(captured * 255))
    np.testing.assert_array_equal(parts["rendered"], np.round(rendered * 255))
    assert parts["error"].shape == captured.shape
    same = split_picture(side_by_side(captured, captured, "label"))["error"]
    assert (same == same[0, 0]).all() and (parts["error"] != same).any()


def test_large_pictures_that_are_blocks_anyway_lose_nothing():
    blocks = np.random.default_rng(1).random((200, 10, 3)).astype(np.float32).repeat(ENLARGE, 0).repeat(ENLARGE, 1)
    found = split_picture(side_by_side(blocks, blocks, "label"))["captured"]
    np.testing.assert_array_equal(found.repeat(ENLARGE, 0).repeat(ENLARGE, 1), np.round(blocks * 255))


def test_scale_starts_with_the_colour_of_no_error():
    image = np.zeros((20, 20, 3), np.float32)
    first = split_picture(side_by_side(image, image, ""))["error"][0, 0]
    assert heat_css().startswith(f"linear-gradient(90deg, rgb({','.join(map(str, first))}), ")


def test_preview_is_encoded_for_a_display():
    """Linear 0.2140 is the middle of sRGB; what is beyond the display's range, or no number, is cut."""
    shown = preview_srgb(np.array([[[0.2140, 2.0, -1.0], [np.nan, 0.0, 1.0]]]))
    np.testing.assert_allclose(shown, [[[0.5, 1, 0], [0, 0, 1]]], atol=1e-4)
