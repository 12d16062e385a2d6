"""Silhouettes for frames without a mask, from the masks of the same camera before and after.

Signed distances of both, each moved so that the subject's centroid goes straight from one to the other, are averaged by
time (shape-based interpolation; Raya and Udupa, 1990). That is right for what moves as the whole subject does, and
roughly right for limbs that move less than their own width. Measured on the walking figure of the tests (12 mm pixels,
every third frame masked, sigma 2 px), mean error of the frames between, without and with: 2.93 and 2.67 mm at 96 frames
a second, 4.1 and 9.5 mm at 24. Hence masks that are near in time, trusted little, and only if asked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Float64, Int64

from pipeline.geometry.signed_distance import FARTHEST_PX, View


def interpolated_views(
    views: Sequence[View],
    times_s: Float64[np.ndarray, " frames"],
    takes: Int64[np.ndarray, " frames"],
    most_frames: int,
) -> list[View]:
    """Views of the frames without a mask that have one shortly before and one after.

    Both are at most `most_frames` away and in the same take. In the result these frames are the usable ones, and the
    only ones.
    """
    return [_interpolated(view, times_s, takes, most_frames) for view in views]


def _interpolated(view: View, times_s: np.ndarray, takes: np.ndarray, most_frames: int) -> View:
    known = np.flatnonzero(view.usable)
    distance, usable = np.zeros_like(view.distance), np.zeros_like(view.usable)
    for frame in np.flatnonzero(~view.usable):
        before, after = known[known < frame], known[known > frame]
        if not len(before) or not len(after):
            continue
        first, last = int(before[-1]), int(after[0])
        near = frame - first <= most_frames and last - frame <= most_frames
        if near and takes[first] == takes[frame] == takes[last]:
            share = float((times_s[frame] - times_s[first]) / (times_s[last] - times_s[first]))
            distance[frame], usable[frame] = _between(view, first, last, share), True
    return replace(view, distance=distance, usable=usable, mask=distance > 0, binary=False)


def _between(view: View, first: int, last: int, share: float) -> np.ndarray:
    centroids = np.array([np.argwhere(view.mask[frame]).mean(0)[::-1] for frame in (first, last)])
    way = centroids[1] - centroids[0]
    moved = [_moved(view.distance[first], share * way), _moved(view.distance[last], (share - 1) * way)]
    return (1 - share) * moved[0] + share * moved[1]


def _moved(distance: np.ndarray, way: np.ndarray) -> np.ndarray:
    shift = np.array([[1.0, 0.0, way[0]], [0.0, 1.0, way[1]]])
    return cv2.warpAffine(
        distance, shift, distance.shape[::-1], flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT,
        borderValue=-FARTHEST_PX,
    )  # fmt: skip
