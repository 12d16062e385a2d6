"""Labels cover neither each other nor points; their real extents are asked of matplotlib's renderer."""

from __future__ import annotations

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from pipeline.figures.labels import place_labels


def place(points):
    figure = Figure(figsize=(6, 6), dpi=100)
    axes = figure.add_axes((0.05, 0.05, 0.9, 0.9), xlim=(-1, 1), ylim=(-1, 1))
    names = [f"cam{k:02d}" for k in range(len(points))]
    lost = place_labels(axes, points, names, ["black"] * len(points), points)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    # An annotation's own extent would include its line to the point.
    boxes = [Text.get_window_extent(text, canvas.get_renderer()) for text in axes.texts]
    texts = [text.get_text() for text in axes.texts]
    return axes, lost, boxes, texts, names


def test_labels_of_a_ring_are_all_placed_and_apart():
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    points = 0.8 * np.stack([np.cos(angle), np.sin(angle)], 1)
    axes, lost, boxes, texts, names = place(points)
    assert lost == 0
    assert texts == names
    frame, dots = axes.get_window_extent(), axes.transData.transform(points)
    for k, box in enumerate(boxes):
        assert frame.contains(box.x0, box.y0) and frame.contains(box.x1, box.y1)
        assert not any(box.contains(*dot) for dot in dots)
        assert not any(box.overlaps(other) for other in boxes[:k])


def test_what_finds_no_room_is_counted_not_drawn_over_others():
    points = np.zeros((60, 2)) + np.random.default_rng(0).normal(0, 1e-3, (60, 2))
    _, lost, _, texts, names = place(points)
    assert 0 < lost < len(names)
    assert len(texts) == len(names) - lost
