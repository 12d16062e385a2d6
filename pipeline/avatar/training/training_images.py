"""Images that an avatar is trained on, and their order.

All of them, or those of fewer cameras or light patterns.

The same images for equal settings, and fewer is always a part of more: 2 of 4 of 8 cameras, 10 of 20 of 50 % of the
patterns.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np
import pandas as pd

from pipeline.base.errors import InputError, listed
from pipeline.base.seeds import generator_for
from pipeline.base.splits import TEST_FLAGS, VALIDATION
from pipeline.capture.records import FrameRecord
from pipeline.config.train_avatar import TrainAvatar


class Schedule:
    """Images of each step. Every epoch all frames in random order, their cameras in random groups.

    Frames are dealt to the places of a round once and for all, as evenly as they can be: a process that always takes
    the steps of one place traces and keeps its own frames only. Where those of a place are used up before an epoch
    ends, it takes others'.
    """

    def __init__(
        self, subject: str, frame_of_image: Sequence[int], cameras_per_step: int, steps_together: int = 1
    ) -> None:
        self.subject, self.cameras_per_step, self.steps_together = subject, cameras_per_step, steps_together
        self.by_frame: dict[int, list[int]] = defaultdict(list)
        for index, frame in enumerate(frame_of_image):
            self.by_frame[frame].append(index)
        dealt = generator_for(subject, "train_avatar", "places").permutation(sorted(self.by_frame)).tolist()
        self.place = {frame: number % steps_together for number, frame in enumerate(dealt)}
        self.steps_per_epoch = sum(-(-len(group) // cameras_per_step) for group in self.by_frame.values())
        self.epoch = lru_cache(maxsize=2)(self._epoch)

    def _epoch(self, epoch: int) -> list[list[int]]:
        generator = generator_for(self.subject, "train_avatar", epoch)
        groups, places = [], []
        for frame in sorted(self.by_frame):
            shuffled = generator.permutation(self.by_frame[frame]).tolist()
            mine = [shuffled[i : i + self.cameras_per_step] for i in range(0, len(shuffled), self.cameras_per_step)]
            groups, places = groups + mine, places + [self.place[frame]] * len(mine)
        left: list[list[list[int]]] = [[] for _ in range(self.steps_together)]
        for i in generator.permutation(len(groups)):
            left[places[i]].append(groups[i])
        first = epoch * self.steps_per_epoch
        return [
            (left[step % self.steps_together] or max(left, key=len)).pop() for step in range(first, first + len(groups))
        ]

    def __getitem__(self, step: int) -> list[int]:
        """Indices of the images of one step; all belong to one frame."""
        epoch, position = divmod(step, self.steps_per_epoch)
        return self.epoch(epoch)[position]


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


def require_no_held_out(table: pd.DataFrame, shards: object) -> None:
    """Refuse images that are to be tested or chosen on.

    Args:
        table: of `ImageShards`.
        shards: where they are from, for the message.

    Raises:
        InputError: naming some of them, and their flags.
    """
    flags = [*TEST_FLAGS, VALIDATION]
    if (bad := table[table[flags].any(axis=1)]).empty:
        return
    found = [f"{row.camera}/{row.frame} ({', '.join(f for f in flags if getattr(row, f))})" for row in bad.itertuples()]
    raise InputError(f"{shards}: expected no held-out images, found {listed(found)}; run pack_shards again")


def spread_cameras(table: pd.DataFrame, count: int) -> list[str]:
    """So many cameras, each as far as can be from those before it. Beginning with the first by name."""
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
    """Partially lit frames under the first `share` of their patterns, at least one. Patterns are in random order."""
    patterns: dict[bytes, list[int]] = {}
    for frame in sorted(table.frame[~table.fully_lit].unique().tolist()):
        record = frames[frame]
        patterns.setdefault(record.light_positions.tobytes() + record.light_intensities.tobytes(), []).append(frame)
    groups = list(patterns.values())
    order = generator_for(subject, "train_avatar", "patterns").permutation(len(groups))
    return [frame for place in order[: math.ceil(share * len(groups))] for frame in groups[place]]
