"""Visibility bits kept in files, found again by what they were traced from: never stale, and safe to delete."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pipeline.base.files import digest_bytes, read_arrays, write_arrays
from pipeline.lighting.visibility import LIGHT_CLEARANCE, ORIGIN_OFFSET
from pipeline.lighting.visibility_bits import VisibilityBits


def visibility_key(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray, places: np.ndarray) -> str:
    """Digest of all that visibility depends on: points and mesh, lights, and the offsets of the rays."""
    offsets = np.array([ORIGIN_OFFSET, LIGHT_CLEARANCE])
    parts = [np.ascontiguousarray(array, dtype) for array, dtype in (
        (points, np.float64), (vertices, np.float64), (faces, np.int64), (places, np.float64), (offsets, np.float64)
    )]  # fmt: skip
    return digest_bytes(b"".join(str(part.shape).encode() + part.tobytes() for part in parts))


def load_bits(folder: Path, key: str) -> VisibilityBits | None:
    """The bits of that key, if they were kept."""
    path = folder / f"{key}.safetensors"
    if not path.is_file():
        return None
    arrays = read_arrays(path)
    return VisibilityBits(arrays["bits"], int(arrays["points"][0]), int(arrays["points"][1]))


def keep_bits(folder: Path, key: str, visibility: VisibilityBits) -> None:
    """Write the bits under their key."""
    counts = np.array([visibility.points, visibility.rays], np.int64)
    write_arrays(folder / f"{key}.safetensors", {"bits": visibility.bits, "points": counts})
