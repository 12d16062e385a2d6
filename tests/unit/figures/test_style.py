"""What all pictures share."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pipeline.figures.style import add_panels, grid_size, picture, round_factor, show_gray, shown_count, worst


@pytest.mark.parametrize(
    ("factor", "rounded"), [(0.3, 1), (1, 1), (1.9, 1), (2, 2), (4.99, 2), (50, 50), (99, 50), (730, 500), (1000, 1000)]
)
def test_factors_are_rounded_down(factor, rounded):
    assert round_factor(float(factor)) == rounded


def test_worst_grade_comes_before_score():
    scores = {"a": 9.0, "b": 1.0, "c": 2.0, "d": 8.0, "e": 0.1}
    assert worst(scores, {"e": "failed", "b": "weak"}, 4) == ["a", "b", "d", "e"]
    assert worst(scores, {"e": "failed", "b": "weak"}, 2) == ["b", "e"]
    assert worst(scores, {}, 99) == list("abcde")
    assert shown_count(24, 160, "cameras") == "the 24 worst of 160 cameras"
    assert shown_count(12, 12, "cameras") == "all 12 cameras"


@pytest.mark.parametrize("count", [1, 5, 24])
def test_panels_lie_apart_and_inside_the_figure(tmp_path, count):
    size, columns = grid_size(count, (2.0, 1.5))
    with picture(tmp_path / "grid.png", size, "Title", ["a note"]) as figure:
        boxes = [axes.get_position() for axes in add_panels(figure, count, (2.0, 1.5), columns)]
    for k, box in enumerate(boxes):
        assert box.x0 >= 0 and box.y0 >= 0 and box.x1 <= 1 and box.y1 <= 1
        assert not any(box.overlaps(other) for other in boxes[:k])
    assert size[0] <= 13


def test_pictures_are_the_same_bytes_on_every_run(tmp_path):
    gray = np.random.default_rng(0).uniform(0, 255, (300, 400)).astype(np.uint8)
    for name in "ab":
        with picture(tmp_path / f"{name}.png", (4.0, 3.0), "Title", []) as figure:
            show_gray(add_panels(figure, 1, (3.0, 2.0), 1)[0], gray, (0, 0), dark=0.0, white=255.0)
    content = [(tmp_path / f"{name}.png").read_bytes() for name in "ab"]
    assert content[0] == content[1]
    assert cv2.imdecode(np.frombuffer(content[0], np.uint8), cv2.IMREAD_COLOR) is not None
    assert not list(tmp_path.glob(".*"))


def test_gray_pixels_lie_where_the_convention_has_them(tmp_path):
    """A bright pixel whose first corner is (13, 27) covers 13 .. 14 and 27 .. 28, also where the image is shrunk."""
    with picture(tmp_path / "p.png", (4.0, 4.0), "", []) as figure:
        axes = add_panels(figure, 1, (3.0, 3.0), 1)[0]
        for side in (40, 4000):
            gray = np.zeros((side, side), np.float32)
            show_gray(axes, gray, (13, 27), dark=0.0, white=1.0)
            assert tuple(axes.images[-1].get_extent()) == (13, 13 + side, 27 + side, 27)
            # Never finer than the panel: files stay small whatever the sensor.
            assert max(axes.images[-1].get_array().shape) <= 301
