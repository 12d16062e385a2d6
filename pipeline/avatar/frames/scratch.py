"""Traced light of frames on a local disk: reading it takes far less time than tracing it."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import torch

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.base.files import read_arrays, write_arrays

STORED = ("visibility_bits", "bounces")
"""What takes long to trace. Light has no part in it, so that it is written once for each frame."""

FREE_SHARE = 0.5
"""Share of the disk's free space that may be filled."""


class Scratch:
    """A folder with a file for each frame, until half of the disk's free space is used up.

    Args:
        folder: exists, and is this process' alone.
        most_bytes: of all files; by default half of what is free.
    """

    def __init__(self, folder: Path, most_bytes: float | None = None) -> None:
        self.folder = folder
        self.left = FREE_SHARE * shutil.disk_usage(folder).free if most_bytes is None else most_bytes

    def store(self, number: int, frame: FrameInputs) -> None:
        """Write what was traced of a frame, unless that was done, or there is no room."""
        known = vars(frame)
        arrays = {name: _array(known[name]) for name in STORED if name in known}
        size = sum(array.nbytes for array in arrays.values())
        if arrays and size <= self.left and not self._path(number).exists():
            self.left -= size
            write_arrays(self._path(number), arrays)

    def restore(self, number: int, frame: FrameInputs) -> None:
        """Give a frame what was traced of it before."""
        if not self._path(number).exists():
            return
        for name, array in read_arrays(self._path(number)).items():
            vars(frame)[name] = torch.tensor(array, device=frame.device) if name == "bounces" else array

    def _path(self, number: int) -> Path:
        return self.folder / f"{number}.safetensors"


@contextmanager
def own_scratch(folder: Path | None) -> Iterator[Scratch | None]:
    """Scratch of this process, in a folder below `folder` that is deleted in the end; or None."""
    if folder is None:
        yield None
        return
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="training_", dir=folder, ignore_cleanup_errors=True) as own:
        yield Scratch(Path(own))


def _array(traced: np.ndarray | torch.Tensor) -> np.ndarray:
    return traced.cpu().numpy() if isinstance(traced, torch.Tensor) else traced
