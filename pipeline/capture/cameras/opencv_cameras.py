"""Reading cameras from files of OpenCV's FileStorage, as OpenCV's own programs write them.

- apps/multiview-calibration, one file: `cam_ids`, `Ks`, `distortions` end to end, `models` (1: fisheye), `image_sizes`,
  `Rs` (or vectors), `Ts`.
- ccalib's MultiCameraCalibration::writeParameters, one file: `nCameras`, and `camera_matrix_0`,
  `camera_distortion_0`, `camera_pose_0` of each; the capture's cameras are called 0, 1 ..., or `cam_0`.
- samples/cpp/calibration.cpp, a folder with a file per camera, named after it: `image_width`, `image_height`,
  `camera_matrix`, `distortion_coefficients`, `fisheye_model`. It has no pose; `R` (matrix or Rodrigues vector) and `T`
  may be added.

Poses are camera-from-world as cv2.projectPoints takes them; the world of the first two is the first camera, in the
board's unit. Pixels are counted from their centres: half a pixel is added.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pipeline.base.errors import Complaints, InputError, listed
from pipeline.capture.cameras.camera_formats import SourceImage, camera_from_lens, finite_numbers
from pipeline.capture.cameras.file_storage import looks_like_storage, open_storage, values
from pipeline.capture.cameras.opencv_lenses import COUNTS, opencv_lens

Sizes = Mapping[str, tuple[int, int]]

SUFFIXES = (".yml", ".yaml", ".xml", ".json")

RIG_KEYS = ("Ks", "nCameras")
LENS_KEY = "camera_matrix"

PREFIX = "cam_"

FISHEYE_MODEL = 1
"""cv2.CALIB_MODEL_FISHEYE."""

FISHEYE_COUNT = 4


def is_opencv(path: Path) -> bool:
    """Tell whether this is a file of a rig, or a folder with one file per camera."""
    if path.is_dir():
        return any(LENS_KEY in _contents(file) for file in _files(path) if looks_like_storage(file))
    named = path.suffix.lower() in SUFFIXES and looks_like_storage(path)
    return named and any(key in _contents(path) for key in RIG_KEYS)


def read_opencv(path: Path, cameras: Sizes, complaints: Complaints) -> list[SourceImage]:
    """The cameras of a file or a folder. Those that are none of the capture's may be anything.

    Args:
        cameras: their sensors' width and height, for files without a size.

    Raises:
        InputError: if it is none of the layouts.
    """
    if path.is_dir():
        entries = {file.stem: (file.name, file) for file in _files(path)}
        return [
            _read_one(name, label, lambda file=file: _single(_contents(file, strict=True)), cameras, complaints)
            for name, (label, file) in entries.items()
        ]
    content = _contents(path, strict=True)
    if "Ks" in content:
        parts = _multiview(content)
    elif "nCameras" in content:
        count = int(finite_numbers(content, "nCameras", ()))
        parts = {str(k): _ccalib(content, k) for k in range(count)}
    else:
        hint = "give a folder with a file per camera, named after it" if LENS_KEY in content else (
            "stereo pairs (M1, D1) and other layouts have no names of cameras: give a folder with a file per camera"
        )  # fmt: skip
        found = listed(list(content)) or "none"
        raise InputError(f"expected the keys of a rig, {' or '.join(RIG_KEYS)}, found {found}; {hint}")
    return [_read_one(name, name, lambda part=part: part, cameras, complaints) for name, part in parts.items()]


def _files(folder: Path) -> list[Path]:
    return sorted(file for file in folder.iterdir() if file.suffix.lower() in SUFFIXES and file.is_file())


def _contents(file: Path, *, strict: bool = False) -> dict[str, Any]:
    try:
        return values(open_storage(file))
    except InputError:
        if strict:
            raise
        return {}


def _read_one(name: str, label: str, part: Any, cameras: Sizes, complaints: Complaints) -> SourceImage:
    """The camera of one part, whose keys are those of a file per camera."""
    owner = next((known for known in (name, PREFIX + name) if known in cameras), name)
    camera, posed = None, True
    with complaints.collecting():
        if owner in cameras:
            try:
                content = part()
                size = _size(content, cameras[owner])
                fisheye = bool(content.get("fisheye_model", 0))
                lens = opencv_lens(content, LENS_KEY, "distortion_coefficients", size, fisheye=fisheye)
                posed = "R" in content or "T" in content
                R, t = (_rotation(content), finite_numbers(content, "T", (3,))) if posed else (np.eye(3), np.zeros(3))
                camera = camera_from_lens(R, t, lens)
            except InputError as error:
                raise InputError(f"camera {label}: {error}") from error
    return SourceImage(owner, owner, camera, posed)


def _size(content: Mapping[str, Any], otherwise: tuple[int, int]) -> tuple[int, int]:
    if "image_width" not in content:
        return otherwise
    return tuple(int(finite_numbers(content, f"image_{side}", ())) for side in ("width", "height"))


def _rotation(content: Mapping[str, Any]) -> np.ndarray:
    if np.size(content.get("R", 0)) == 3:
        return cv2.Rodrigues(finite_numbers(content, "R", (3,)))[0]
    return finite_numbers(content, "R", (3, 3))


def _single(content: dict[str, Any]) -> dict[str, Any]:
    if LENS_KEY not in content:
        raise InputError(f"{LENS_KEY}: expected this key, found {listed(list(content)) or 'none'}")
    return content


def _ccalib(content: Mapping[str, Any], number: int) -> dict[str, Any]:
    """One camera of MultiCameraCalibration, by the keys of a file per camera."""
    if f"xi_{number}" in content:
        raise InputError(f"xi_{number}: expected perspective cameras, found omnidirectional ones; undistort the images")
    pose = finite_numbers(content, f"camera_pose_{number}", (4, 4))
    named = {LENS_KEY: "camera_matrix", "distortion_coefficients": "camera_distortion"}
    part = {key: content[f"{theirs}_{number}"] for key, theirs in named.items() if f"{theirs}_{number}" in content}
    return {**part, "R": pose[:3, :3], "T": pose[:3, 3]}


def _multiview(content: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Cameras of the multiview application, by the keys of a file per camera."""
    count = len(np.atleast_3d(content["Ks"]))
    Ks = finite_numbers(content, "Ks", (count, 3, 3))
    names = content.get("cam_ids")
    if not isinstance(names, list) or len(names) != count or len(set(names)) != count:
        raise InputError(f"cam_ids: expected the names of {count} cameras, found {names or 'none'}")
    sizes, Ts = (finite_numbers(content, key, (count, n)) for key, n in (("image_sizes", 2), ("Ts", 3)))
    turns = np.asarray(content.get("Rs", np.zeros(0)), np.float64)
    if turns.size not in (9 * count, 3 * count):
        raise InputError(f"Rs: expected {count} rotations, found {turns.size} numbers")
    turns = turns.reshape((count, 3, 3) if turns.size == 9 * count else (count, 3))
    fisheyes = finite_numbers(content, "models", (count,)) == FISHEYE_MODEL
    lenses = _shares(finite_numbers(content, "distortions", (np.size(content.get("distortions", 0)),)), fisheyes)
    return {
        name: {
            LENS_KEY: Ks[k], "distortion_coefficients": lenses[k], "fisheye_model": float(fisheyes[k]),
            "image_width": sizes[k, 0], "image_height": sizes[k, 1], "R": turns[k], "T": Ts[k],
        }
        for k, name in enumerate(names)
    }  # fmt: skip


def _shares(numbers: np.ndarray, fisheyes: np.ndarray) -> list[np.ndarray]:
    """Each camera's own coefficients, which the file has end to end."""
    plain = int((~fisheyes).sum())
    rest = numbers.size - FISHEYE_COUNT * int(fisheyes.sum())
    if rest % max(plain, 1) or (plain and rest // plain not in COUNTS) or (not plain and rest):
        found = f"{numbers.size} for {plain} of them and {int(fisheyes.sum())} fisheyes"
        raise InputError(f"distortions: expected 4, 5, 8, 12 or 14 coefficients per perspective camera, found {found}")
    counts = np.where(fisheyes, FISHEYE_COUNT, rest // max(plain, 1))
    return np.split(numbers, np.cumsum(counts)[:-1])
