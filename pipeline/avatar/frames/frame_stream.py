"""Inputs of frames, read as training asks for them, and kept within a number of bytes."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass

import numpy as np
import torch
from jaxtyping import Bool

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.frames.light_gains import AS_CALIBRATED, LightGains
from pipeline.avatar.frames.scratch import Scratch
from pipeline.capture.records import FrameRecord
from pipeline.geometry.texels import Atlas

UNCOUNTED = ("atlas", "sky", "gains", "shadowed", "device")
"""What all frames share."""


class FrameStream(Mapping[int, FrameInputs]):
    """Inputs by frame number, read when they are asked for.

    The frames that were visited last are kept, for they are in use. Of those before them as many are kept as fit into
    `most_bytes`, first come, first kept: an epoch visits all frames in random order, so none is needed sooner than
    others, and of those that make room for the latest hardly one would be there when its turn comes. What is kept and
    what is read anew has the same bits. May be used by several threads.

    Args:
        atlas: of the texels.
        records: of the frames, such as `FrameShards`.
        most_bytes: bytes that kept frames may hold, beside those in use; None: all are kept.
        in_use: number of frames that are visited at a time.
        device: where their tensors lie.
        scratch: where the traced light of other frames is kept; None: it is traced anew.
        shadowed: as `FrameInputs` has it.
    """

    def __init__(
        self, atlas: Atlas, records: Mapping[int, FrameRecord], most_bytes: float | None = None, in_use: int = 1,
        device: torch.device | str = "cpu", scratch: Scratch | None = None,
        shadowed: Bool[np.ndarray, " texels"] | None = None,
    ) -> None:  # fmt: skip
        self.scratch, self.shadowed = scratch, shadowed
        self.atlas, self.records, self.device = atlas, records, device
        self.most_bytes, self.in_use = most_bytes, in_use
        self._gains, self._lock = AS_CALIBRATED, threading.Lock()
        self._visited: dict[int, FrameInputs] = {}  # the latest is the last
        self._kept: dict[int, FrameInputs] = {}
        self._bytes: dict[int, int] = {}

    def __len__(self) -> int:
        return len(self.records)

    def __iter__(self) -> Iterator[int]:
        return iter(self.records)

    def __getitem__(self, number: int) -> FrameInputs:
        with self._lock:
            found, gains = self._visited.get(number) or self._kept.get(number), self._gains
        if found is None:
            found = FrameInputs(
                self.atlas, self.records[number], gains=gains, shadowed=self.shadowed, device=self.device
            )
            if self.scratch is not None:
                self.scratch.restore(number, found)
        gone = {}
        with self._lock:
            self._visited.pop(number, None)
            self._visited[number] = found
            while len(self._visited) > self.in_use:
                oldest = next(iter(self._visited))
                frame = self._visited.pop(oldest)
                if not self._leave(oldest, frame):
                    gone[oldest] = frame
        for oldest, frame in gone.items():
            if self.scratch is not None:
                self.scratch.store(oldest, frame)
        return found

    @property
    def kept_bytes(self) -> int:
        """Bytes of the frames that are kept, beside those visited last."""
        with self._lock:
            return sum(self._bytes.values())

    def relight(self, gains: LightGains) -> None:
        """Light all frames by lights of other brightness; no other thread may ask for one meanwhile."""
        with self._lock:
            self._gains = gains
            for frames in (self._visited, self._kept):
                frames.update({number: frame.with_gains(gains) for number, frame in frames.items()})

    def _leave(self, number: int, frame: FrameInputs) -> bool:
        """Keep a frame that is in use no longer, with all that its visit made, if there is room: whether there is."""
        self._kept.pop(number, None)
        self._bytes.pop(number, None)
        size = held_bytes(frame)
        room = self.most_bytes is None or sum(self._bytes.values()) + size <= self.most_bytes
        if room:
            self._kept[number], self._bytes[number] = frame, size
        return room


def held_bytes(frame: FrameInputs) -> int:
    """Bytes of the arrays that a frame's inputs hold by now; the atlas is all frames'."""
    return _array_bytes({name: value for name, value in vars(frame).items() if name not in UNCOUNTED})


def _array_bytes(held: object) -> int:
    """Bytes of the arrays within dictionaries, tuples and dataclasses."""
    if isinstance(held, torch.Tensor | np.ndarray):
        return held.nbytes
    if is_dataclass(held):
        return sum(_array_bytes(getattr(held, one.name)) for one in fields(held))
    if isinstance(held, dict):
        return sum(_array_bytes(value) for value in held.values())
    return sum(_array_bytes(value) for value in held) if isinstance(held, tuple) else 0
