"""Masks of a set, decoded once while it is imported.

They are looked at for what their values mean, and again to project meshes into them.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from pipeline.capture.archives import holder_of, read_bytes
from pipeline.capture.images import decode_mask

KEPT = 64
"""Latest masks that are kept: one of each camera of a set of still subjects, at most 5 MB each."""


def read_set_mask(path: Path) -> UInt8[np.ndarray, "height width"]:
    """A mask as it is stored, decoded once if it is asked for again soon. It cannot be written into.

    Raises:
        InputError: if it cannot be read, or is no mask.
    """
    holder = holder_of(path)
    return _kept(path, holder.stat().st_mtime_ns if holder.is_file() else 0)


@lru_cache(maxsize=KEPT)
def _kept(path: Path, _changed_ns: int) -> UInt8[np.ndarray, "height width"]:
    mask = decode_mask(read_bytes(path), path)
    mask.flags.writeable = False
    return mask
