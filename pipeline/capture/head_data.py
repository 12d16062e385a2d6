"""Data of a head's frames beside those of every frame: rigid motion, gaze, mean texture."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32, Int

from pipeline.base.errors import InputError
from pipeline.base.files import read_arrays, read_table, write_arrays
from pipeline.geometry.rotations import matrix_from_quaternion


def head_motions(tracked: Mapping[str, np.ndarray]) -> dict[int, Float32[np.ndarray, "3 4"]]:
    """Rigid motion [R | t] by frame, from the stage to the frame of the template at rest.

    From the arrays of track_mesh: the inverse of x = R p + t, metres, by which track_mesh moves a point p of the
    template as a whole.
    """
    turn = matrix_from_quaternion(tracked["root_rotation"].astype(np.float64)).transpose(0, 2, 1)
    shift = -turn @ tracked["root_translation"].astype(np.float64)[..., None]
    motions = np.concatenate([turn, shift], axis=2).astype(np.float32)
    return dict(zip(tracked["frames"].tolist(), motions, strict=True))


def read_gaze(path: Path) -> dict[int, Float32[np.ndarray, "eyes 3"]]:
    """Unit directions of index/gaze.parquet by frame, eyes in the order of their names."""
    table = read_table(path).sort_values(["frame", "eye"])
    return {int(frame): rows[["x", "y", "z"]].to_numpy(np.float32) for frame, rows in table.groupby("frame")}


def write_textures(path: Path, frames: Int[np.ndarray, " n"], textures: Float[np.ndarray, "n texels 3"]) -> None:
    """Write mean textures, linear RGB, as float16."""
    write_arrays(path, {"frames": frames.astype(np.int64), "textures": textures.astype(np.float16)})


def read_textures(path: Path) -> dict[int, Float32[np.ndarray, "texels 3"]]:
    """Mean textures by frame, linear RGB.

    Raises:
        InputError: if the file is not what `write_textures` writes.
    """
    arrays = read_arrays(path)
    frames, textures = arrays.get("frames"), arrays.get("textures")
    if frames is None or textures is None or textures.shape != (len(frames), textures.shape[1], 3):
        found = {name: array.shape for name, array in arrays.items()}
        raise InputError(
            f"{path}: expected frames [n] and textures [n, texels, 3], found {found}; run bake_textures again"
        )
    return dict(zip(frames.tolist(), textures.astype(np.float32), strict=True))
