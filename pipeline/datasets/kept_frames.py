"""Frames of a set that can be used: those with a mesh, and those between two of one segment."""

from __future__ import annotations

import logging
from collections.abc import Collection

import numpy as np
import pandas as pd

from pipeline.base.errors import InputError, listed
from pipeline.geometry.pose_interpolation import neighbours

log = logging.getLogger(__name__)


def frames_with_meshes(frames: pd.DataFrame, meshed: Collection[int], where: str) -> tuple[pd.DataFrame, list[int]]:
    """Frames that have a mesh or lie between two, and the numbers of the others.

    What moves has no known place before its first and after its last mesh: such frames are left out, not guessed.

    Args:
        frames: frame, segment, in order.
        meshed: frames with a mesh.
        where: the set, for messages.

    Raises:
        InputError: if no frame has a mesh.
    """
    has = frames.frame.isin(list(meshed)).to_numpy()
    if not has.any():
        raise InputError(f"{where}: expected meshes of some of its {len(frames)} frames, found none")
    takes = pd.factorize(frames.segment)[0].astype(np.int64)
    known = np.flatnonzero(has).astype(np.int64)
    before, after, _ = neighbours(known, len(frames), takes)
    same = (takes[known[before]] == takes) & (takes[known[after]] == takes)
    kept = has | (same & (before != after))
    between, dropped = frames.frame[kept & ~has].tolist(), frames.frame[~kept].tolist()
    if between:
        log.info("%d frames without a mesh lie between two and get an interpolated one: %s", len(between), between)
    if dropped:
        log.warning("%d frames lie between no two meshes of their segment; left out: %s", len(dropped), dropped)
    return frames[kept].reset_index(drop=True), dropped


def shown(numbers: Collection[object]) -> str:
    """Count of the numbers, and the first of them."""
    return f"{len(numbers)}: {listed(numbers)}"
