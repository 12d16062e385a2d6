"""Motion of boards in images that were not taken at once.

How fast each corner moves, when it was seen, and where a board rests.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float64, Int64

from pipeline.calibration.cameras.rig_inputs import NOTHING_KNOWN, Motion, Observations

LONGEST_GAP_S = 0.5
"""Time between two images of a camera above which they say nothing of a velocity: a hand turns round in it."""

CORNER_PX = 0.2
"""Noise of a corner to begin with, as detectors have it: what a moving corner's error is compared with."""


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
    return moving.select(~_shared(observations) | np.isfinite(velocity).all(1))


def restful_shots(
    observations: Observations, shot: Int64[np.ndarray, " views"], most: int
) -> Int64[np.ndarray, " shots"]:
    """At most so many shots: of each stretch of successive ones that whose corners tell most.

    A corner's error grows with its speed, by what ordinary cameras' times are off. Views of one camera alone say
    nothing of where cameras stand, and count only where a stretch has no others.

    Args:
        observations: with their motion.
        shot: of each view.
    """
    speed = np.linalg.norm(observations.motion.velocity, axis=1)
    worth = _shared(observations) / (1 + (speed * NOTHING_KNOWN.clock_sigma_s / CORNER_PX) ** 2)
    shots, place = np.unique(shot[observations.view], return_inverse=True)
    worth_of, corners = np.bincount(place, worth), np.bincount(place)
    stretches = np.array_split(np.arange(len(shots)), min(most, len(shots)))
    return shots[[max(stretch, key=lambda k: (worth_of[k], corners[k])) for stretch in stretches]]


def _shared(observations: Observations) -> Bool[np.ndarray, " observations"]:
    """True for corners of views that several cameras see."""
    images = np.unique(np.stack([observations.camera, observations.view], 1), axis=0)
    return np.bincount(images[:, 1])[observations.view] > 1


def _mean_of_view(time: Float64[np.ndarray, " n"], observations: Observations) -> Float64[np.ndarray, " n"]:
    """Of each observation, the mean time of its view's images, each counted once."""
    images, first = np.unique(np.stack([observations.camera, observations.view], 1), axis=0, return_index=True)
    count = np.bincount(images[:, 1])
    return (np.bincount(images[:, 1], time[first]) / np.maximum(count, 1))[observations.view]
