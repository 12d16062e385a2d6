"""Placing labels beside points so that none covers another or a point."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke

CHARACTER = 0.62
"""Mean width of a character over the font size."""

DISTANCES_PT = (7.0, 13.0, 20.0, 30.0)
DIRECTIONS = 16


def place_labels(
    axes: Axes, points: Float64[np.ndarray, "labels 2"], texts: Sequence[str], colors: Sequence[str],
    obstacles: Float64[np.ndarray, "points 2"], size_pt: float = 7.5,
) -> int:  # fmt: skip
    """Write each text beside its point; return the number that found no room.

    Greedy: a text takes the first free of `DIRECTIONS` x `DISTANCES_PT` places, nearest first, away from the axes'
    middle first. Limits of the axes have to be final.

    Args:
        points, obstacles: in data coordinates.
    """
    to_pt = 72 / axes.figure.dpi
    transform, box = axes.transData.transform, axes.get_window_extent()
    at = transform(points) * to_pt
    blocked = transform(obstacles) * to_pt if len(obstacles) else np.zeros((0, 2))
    middle = np.array([(box.x0 + box.x1) / 2, (box.y0 + box.y1) / 2]) * to_pt
    frame = np.array([[box.x0, box.y0], [box.x1, box.y1]]) * to_pt
    taken: list[np.ndarray] = []
    for point, anchor, text, color in zip(points, at, texts, colors, strict=True):
        half = np.array([CHARACTER * size_pt * len(text) / 2, 0.55 * size_pt])
        outwards = float(np.arctan2(*(anchor - middle)[::-1]))
        for offset in _offsets(outwards, half):
            low, high = anchor + offset - half, anchor + offset + half
            inside = (low >= frame[0]).all() and (high <= frame[1]).all()
            hit = ((blocked > low - 1) & (blocked < high + 1)).all(1).any()
            overlaps = any((low < other[1]).all() and (high > other[0]).all() for other in taken)
            if inside and not hit and not overlaps:
                taken.append(np.stack([low, high]))
                line = {"arrowstyle": "-", "color": color, "linewidth": 0.4, "shrinkA": 0, "shrinkB": 2}
                axes.annotate(
                    text, point, offset, textcoords="offset points", ha="center", va="center", size=size_pt,
                    color=color, arrowprops=line, path_effects=[withStroke(linewidth=2, foreground="white")],
                )  # fmt: skip
                break
    return len(texts) - len(taken)


def _offsets(outwards: float, half: np.ndarray) -> list[np.ndarray]:
    turns = sorted(np.arange(DIRECTIONS) * 2 * np.pi / DIRECTIONS, key=lambda turn: min(turn, 2 * np.pi - turn))
    rays = [np.array([np.cos(outwards + turn), np.sin(outwards + turn)]) for turn in turns]
    # From the box's middle to its edge along the ray, and the distance beyond.
    return [ray * (distance + np.abs(ray) @ half) for distance in DISTANCES_PT for ray in rays]
