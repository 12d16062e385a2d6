"""Which of the training images an avatar is trained on: all, or those of fewer cameras or fewer light patterns.

The same images for equal settings, and fewer is always a part of more: 2 of 4 of 8 cameras, 10 of 20 of 50 % of the
patterns.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pandas as pd

from pipeline.base.errors import InputError
from pipeline.base.seeds import generator_for
from pipeline.capture.records import FrameRecord
from pipeline.config.train_avatar import TrainAvatar


def chosen_images(
    table: pd.DataFrame, frames: Mapping[int, FrameRecord], settings: TrainAvatar, subject: str
) -> list[int]:
    """Rows of `table` to train on, in their order.

    Args:
        table: of `ImageShards`: camera, frame, fully_lit, R and t of each training image.
        frames: for the lights of each.
        settings: `cameras` and `light_share`.
        subject: seeds the order of the patterns.

    Raises:
        InputError: if more cameras are asked for than there are.
    """
    kept = pd.Series(True, table.index)
    if settings.cameras:
        kept &= table.camera.isin(spread_cameras(table, settings.cameras))
    if settings.light_share < 1:
        kept &= table.fully_lit | table.frame.isin(frames_of_patterns(table, frames, settings.light_share, subject))
    return np.flatnonzero(kept).tolist()


def spread_cameras(table: pd.DataFrame, count: int) -> list[str]:
    """So many cameras, each as far as can be from those before it, beginning with the first by name."""
    first = table.drop_duplicates("camera").sort_values("camera")
    if count > len(first):
        raise InputError(
            f"train_avatar: cameras: expected at most {len(first)}, those with training images, found {count}"
        )
    R, t = (np.array(first[name].tolist()).reshape(-1, 3, n) for name, n in (("R", 3), ("t", 1)))
    centers = -(R.transpose(0, 2, 1) @ t)[..., 0]
    chosen = [0]
    while len(chosen) < count:
        distances = np.linalg.norm(centers[:, None] - centers[chosen], axis=2).min(1)
        chosen.append(int(distances.argmax()))
    return first.camera.iloc[chosen].tolist()


def frames_of_patterns(table: pd.DataFrame, frames: Mapping[int, FrameRecord], share: float, subject: str) -> list[int]:
    """Partially lit frames under the first `share` of their patterns in random order, at least one."""
    patterns: dict[bytes, list[int]] = {}
    for frame in sorted(table.frame[~table.fully_lit].unique().tolist()):
        record = frames[frame]
        patterns.setdefault(record.light_positions.tobytes() + record.light_intensities.tobytes(), []).append(frame)
    groups = list(patterns.values())
    order = generator_for(subject, "train_avatar", "patterns").permutation(len(groups))
    return [frame for place in order[: math.ceil(share * len(groups))] for frame in groups[place]]
