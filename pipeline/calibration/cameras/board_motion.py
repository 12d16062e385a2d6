"""Motion of boards in images that were not taken at once.

How fast each corner moves, and when it was seen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float64, Int64

from pipeline.calibration.cameras.rig_inputs import Motion, Observations

LONGEST_GAP_S = 0.5
"""Time between two images of a camera above which they say nothing of a velocity: a hand turns round in it."""


def with_motion(
    observations: Observations,
    shot: Int64[np.ndarray, " views"],
    board: Int64[np.ndarray, " views"],
    times_s: Mapping[tuple[int, int], float],
) -> Observations:
    """The observations with their corners' velocities.

    Corners of shared views that have none are left out.

    A velocity is that of the parabola through a corner's places in a camera's images before, now and after, or of the
    line through two of them.

    Args:
        shot, board: of each view.
        times_s: when each (camera, shot) was taken.
    """
    camera, at_shot = observations.camera, shot[observations.view]
    time = np.array([times_s[int(c), int(s)] for c, s in zip(camera, at_shot, strict=True)])
    velocity = np.full_like(observations.pixel, np.nan)
    order = np.lexsort((time, observations.corner, board[observations.view], camera))
    key = np.stack([camera, board[observations.view], observations.corner], 1)[order]
    same = np.concatenate([[False], np.all(key[1:] == key[:-1], 1), [False]])
    step = np.diff(time[order], prepend=np.nan, append=np.nan)
    near = same & (step <= LONGEST_GAP_S) & (step > 0)
    pixel = observations.pixel[order]
    slope = np.full((len(order) + 1, 2), np.nan)
    slope[1:-1] = np.diff(pixel, axis=0) / np.where(near, step, np.nan)[1:-1, None]
    before, after = slope[:-1], slope[1:]
    gap_before, gap_after = step[:-1, None], step[1:, None]
    middle = (before * gap_after + after * gap_before) / (gap_before + gap_after)
    velocity[order] = np.where(np.isfinite(middle), middle, np.where(np.isfinite(before), before, after))
    mean = _mean_of_view(time, observations)
    acceleration = np.zeros_like(velocity)
    acceleration[order] = np.nan_to_num(2 * (after - before) / (gap_before + gap_after))
    moving = replace(observations, motion=Motion(np.nan_to_num(velocity), acceleration, time - mean))
    images = np.unique(np.stack([camera, observations.view], 1), axis=0)
    shared = np.bincount(images[:, 1], minlength=len(shot))[observations.view] > 1
    return moving.select(~shared | np.isfinite(velocity).all(1))


def _mean_of_view(time: Float64[np.ndarray, " n"], observations: Observations) -> Float64[np.ndarray, " n"]:
    """Of each observation, the mean time of its view's images, each counted once."""
    images, first = np.unique(np.stack([observations.camera, observations.view], 1), axis=0, return_index=True)
    count = np.bincount(images[:, 1])
    return (np.bincount(images[:, 1], time[first]) / np.maximum(count, 1))[observations.view]
