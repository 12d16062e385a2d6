"""Reading what track_mesh wrote: the posed template of every frame of a chunk."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Int

from pipeline.base.errors import InputError
from pipeline.base.files import read_arrays


@dataclass(frozen=True)
class TrackedChunk:
    """Posed vertices in metres, and local joint rotations (wxyz) if the template is rigged."""

    frames: Int[np.ndarray, " frames"]
    vertices: Float32[np.ndarray, "frames vertices 3"]
    joint_rotations: Float32[np.ndarray, "frames joints 4"] | None


def read_tracked(path: Path, vertex_count: int) -> TrackedChunk:
    """Read tracking/{chunk}.safetensors.

    Raises:
        InputError: if an array is missing or of the wrong shape for a template of `vertex_count` vertices, or a vertex
        is
            not finite.
    """
    arrays = read_arrays(path)
    for name in ("frames", "vertices"):
        if name not in arrays:
            raise InputError(f"{path}: expected an array '{name}', found {sorted(arrays)}; run track_mesh again")
    frames, vertices = arrays["frames"], arrays["vertices"]
    expected = (len(frames), vertex_count, 3)
    if vertices.shape != expected:
        raise InputError(
            f"{path}: vertices: expected shape {expected}, found {vertices.shape}; track and unwrap one template"
        )
    broken = frames[~np.isfinite(vertices).all((1, 2))]
    if len(broken):
        raise InputError(
            f"{path}: vertices: expected finite numbers, found others in frames {broken.tolist()}; track again"
        )
    rotations = arrays.get("joint_rotations")
    if rotations is not None and not np.isfinite(rotations).all():
        raise InputError(f"{path}: joint_rotations: expected finite numbers, found others; track again")
    return TrackedChunk(frames, vertices, rotations)
