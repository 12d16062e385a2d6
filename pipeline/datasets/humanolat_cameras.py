"""Cameras of HumanOLAT: a text whose matrices are written in one direction or in the other."""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from pipeline.base.errors import Complaints, InputError
from pipeline.capture.archives import read_bytes
from pipeline.geometry.cameras import Camera

log = logging.getLogger(__name__)

METRES_PER_UNIT = 0.001
HEADER = "tc camera calibration"

FROM_WORLD, FROM_CAMERA = "camera-from-world", "world-from-camera"
"""The two directions that the set's own programs disagree about."""


@dataclass(frozen=True)
class WrittenCamera:
    """One camera as the file has it.

    Attributes:
        extrinsics: rows r r r t, millimetres.
        intrinsics: the first two rows are divided by the image's width.
        origin: millimetres; NaN where there is no such line.
    """

    extrinsics: Float64[np.ndarray, "3 4"]
    intrinsics: Float64[np.ndarray, "3 3"]
    origin: Float64[np.ndarray, " 3"]

    def as_camera(self, direction: str, size: tuple[int, int]) -> Camera:
        """The camera, its matrix read in one of the directions; images are free of distortion."""
        R, t = self.extrinsics[:, :3], METRES_PER_UNIT * self.extrinsics[:, 3]
        if direction == FROM_CAMERA:
            R, t = R.T, -R.T @ t
        K = self.intrinsics * np.array([[size[0]], [size[0]], [1]])
        return Camera(R.copy(), t, K, np.zeros(5), *size)


def camera_name(number: int) -> str:
    """Name of a camera's folder by its number in the file, which counts from 0."""
    return f"Cam{number + 1:02d}"


def read_calib(path: Path) -> dict[str, WrittenCamera]:
    """Cameras of cameras.calib, by the names of their folders.

    Raises:
        InputError: if the file is of another kind, or a camera lacks a matrix.
    """
    lines = read_bytes(path).decode(errors="replace").splitlines()
    if not lines or HEADER not in lines[0]:
        raise InputError(f"{path}: expected a first line '{HEADER} v0.3', found {lines[:1]}")
    starts = [n for n, line in enumerate(lines) if re.match(r"camera\s+\d+\s", line)]
    complaints, found = Complaints(path), {}
    for start, end in zip(starts, [*starts[1:], len(lines)], strict=True):
        name, block = camera_name(int(lines[start].split()[1])), lines[start + 1 : end]
        matrices = {word: _rows_after(block, word, columns) for word, columns in (("extrinsics", 4), ("intrinsics", 3))}
        if missing := [word for word, matrix in matrices.items() if matrix is None]:
            complaints.add(path.name, name, expected="three rows of numbers after # extrinsics and # intrinsics",
                           found=f"none after {missing[0]}")  # fmt: skip
            continue
        origin = next((_numbers(line.split()[1:]) for line in block if line.startswith("origin")), None)
        usable = origin is not None and len(origin) == 3
        found[name] = WrittenCamera(**matrices, origin=np.array(origin) if usable else np.full(3, np.nan))
    complaints.raise_if_any()
    if not found:
        raise InputError(f"{path}: expected lines 'camera <number> <name>', found none")
    return found


def _rows_after(block: list[str], word: str, columns: int) -> np.ndarray | None:
    """Three rows of numbers after the line that names them; they may be comments, too."""
    at = next((n for n, line in enumerate(block) if line.strip("#\t ").lower().startswith(word)), None)
    if at is None:
        return None
    rows = [_numbers(line.strip("#\t ").split()) for line in block[at + 1 : at + 4]]
    return np.array(rows) if len(rows) == 3 and all(len(row) == columns for row in rows) else None


def _numbers(words: list[str]) -> list[float]:
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        return []
    return numbers if np.isfinite(numbers).all() else []


def vote_of_origins(written: Mapping[str, WrittenCamera]) -> str | None:
    """The direction whose camera centres are at the lines `origin`; None if neither is."""
    errors = {}
    for direction in (FROM_WORLD, FROM_CAMERA):
        away = [
            np.linalg.norm(each.as_camera(direction, (1, 1)).center - METRES_PER_UNIT * each.origin)
            for each in written.values()
            if np.isfinite(each.origin).all()
        ]
        errors[direction] = float(np.median(away)) if away else np.inf
        log.info("read as %s, camera centres are %.4f m from the lines origin (median)", direction, errors[direction])
    best = min(errors, key=lambda direction: errors[direction])
    other = max(errors.values())
    return best if errors[best] < 0.1 * other else None
