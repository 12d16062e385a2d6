"""Landmarks of BecomingLit: those that its preprocessing finds in fully lit images."""

from __future__ import annotations

import zipfile
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.errors import InputError
from pipeline.datasets.becominglit_sequences import SequenceFiles

LANDMARKS, ORDER, COUNT = "landmark2d/PIPnet", "wflw_98", 98
"""Folder of a sequence, and how PIPNet numbers the landmarks of WFLW."""


def landmark_files(root: Path, sequences: Sequence[SequenceFiles], cameras: Collection[str]) -> list[Path]:
    """Files that there are, one per sequence and camera."""
    paths = [root / f"sequences/{each.name}/{LANDMARKS}/cam_{camera}.npz" for each in sequences for camera in cameras]
    return [path for path in paths if path.is_file()]


def read_landmarks(
    root: Path, sequences: Sequence[SequenceFiles], sizes: Mapping[str, tuple[int, int]], frames: Collection[int]
) -> Iterator[pd.DataFrame]:
    """Landmarks in pixels, a table for each file, of those frames.

    Files have them as shares of the image's sides, 98 x 2 by the number of the frame in its sequence. The detector does
    not say how sure it is: confidence is 1.

    Raises:
        InputError: if a file has something else.
    """
    kept = set(frames)
    for each in sequences:
        for camera, size in sizes.items():
            path = root / f"sequences/{each.name}/{LANDMARKS}/cam_{camera}.npz"
            found = {each.first + n: points for n, points in _read(path).items() if each.first + n in kept}
            numbers, pixels = list(found), np.array(list(found.values())).reshape(-1, 2) * size
            yield pd.DataFrame(
                {
                    "frame": np.repeat(np.array(numbers, np.int64), COUNT),
                    "camera": pd.Series([camera] * len(pixels), dtype="str"),
                    "keypoint": pd.Series(list(map(str, range(COUNT))) * len(numbers), dtype="str"),
                    "x": pixels[:, 0], "y": pixels[:, 1], "confidence": np.ones(len(pixels)),
                }
            )  # fmt: skip


def _read(path: Path) -> dict[int, np.ndarray]:
    """Landmarks by frame; none if there is no file."""
    if not path.is_file():
        return {}
    try:
        with np.load(path, allow_pickle=False) as content:
            found = {int(name): np.asarray(content[name], np.float64) for name in content.files}
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: expected arrays named by numbers of frames, found: {error}; delete it") from error
    wrong = {points.shape for points in found.values() if points.shape != (COUNT, 2) or not np.isfinite(points).all()}
    if wrong:
        raise InputError(f"{path}: expected {COUNT} x 2 finite numbers for each frame, found {wrong.pop()}; delete it")
    return found
