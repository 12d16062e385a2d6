"""Tables of OpenIllumination: poses, images, and the lights of each."""

from __future__ import annotations

import logging
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float64

from pipeline.base.errors import Complaints, InputError, listed
from pipeline.datasets.kept_frames import shown
from pipeline.datasets.layout import csv_columns, json_key
from pipeline.datasets.light_durations import light_name
from pipeline.datasets.stage_units import unit_of_stage

log = logging.getLogger(__name__)

OLAT, PATTERNS = "OLAT", "lighting_patterns"
KINDS = (OLAT, PATTERNS)
"""Folders of the set: one light at a time, counted from 0; or patterns, counted from 1. Each is calibrated apart."""

VIEWS = "Lights"
IMAGES = "raw_undistorted"
TRAIN, VALIDATION, TEST = (f"output/transforms_{name}.json" for name in ("train", "val", "test"))
LIGHTS = "light_pos.npy"

UNITS = {1.0: "the lights' unit", 0.25: "a quarter of it"}
"""Some of the set's loaders have positions four times as large; one unit, the stage's radius, counts as a metre."""

ANGLES = (0.0, np.pi)
"""Angles of view that an image with a pinhole's lines has, without the ends."""


@dataclass(frozen=True)
class SplitPose:
    """One camera as the files have it.

    Attributes:
        world_from_camera: in axes that the set's programs disagree about.
        angle_x: of view, across the image's width, radians.
        tests: True if the file of training cameras lacks it.
    """

    world_from_camera: Float64[np.ndarray, "4 4"]
    angle_x: float
    tests: bool


@dataclass(frozen=True)
class LitImages:
    """Frames, which are the numbers of the folders, and the light of each.

    Attributes:
        lights: light, x, y, z, metres in the set's world.
        patterns: frame, light, intensity.
        unit: metres per unit of the cameras' poses.
        lights_said, patterns_said, unit_said: where all this is from.
    """

    frames: Sequence[int]
    lights: pd.DataFrame
    patterns: pd.DataFrame
    unit: float
    lights_said: str
    patterns_said: str
    unit_said: str


def read_poses(root: Path) -> dict[str, SplitPose]:
    """Poses by camera.

    The file of validation cameras repeats those of others, and may be missing.

    Raises:
        InputError: naming all that have no pose or angle, or another one in a later file.
    """
    complaints, found = Complaints(root), {}
    for file in [name for name in (TRAIN, TEST, VALIDATION) if (root / name).is_file()]:
        frames = json_key(root / file, "frames")
        if not isinstance(frames, dict):
            complaints.add(file, "frames", expected="a pose by the name of each camera", found=type(frames).__name__)
            continue
        for name, entry in frames.items():
            pose = _pose(entry, tests=file != TRAIN)
            if pose is None:
                expected = "transform_matrix of 4 x 4 finite numbers, and camera_angle_x between 0 and pi"
                complaints.add(file, name, expected=expected, found=f"{entry!r:.80}")
            elif not np.array_equal(found.setdefault(name, pose).world_from_camera, pose.world_from_camera):
                complaints.add(file, name, expected="the pose of the other files", found="another")
    complaints.raise_if_any()
    return found


def _pose(entry: Any, tests: bool) -> SplitPose | None:
    try:
        matrix, angle = np.array(entry["transform_matrix"], np.float64), float(entry["camera_angle_x"])
    except (KeyError, TypeError, ValueError):
        return None
    usable = matrix.shape == (4, 4) and np.isfinite(matrix).all() and ANGLES[0] < angle < ANGLES[1]
    return SplitPose(matrix, angle, tests) if usable else None


def find_images(root: Path) -> dict[str, dict[int, str]]:
    """Path of each image `Lights/000/raw_undistorted/<camera>.JPG` or .png by camera and number.

    Raises:
        InputError: if there is none.
    """
    found: dict[str, dict[int, str]] = {}
    for path in sorted((root / VIEWS).glob(f"*/{IMAGES}/*")):
        number = path.parent.parent.name
        if re.fullmatch(r"\d+", number) and path.suffix.lower() in (".jpg", ".jpeg", ".png"):
            found.setdefault(path.stem, {})[int(number)] = str(path.relative_to(root))
    if not found:
        raise InputError(f"{root}/{VIEWS}: expected images 000/{IMAGES}/<camera>.JPG and so on, found none")
    return found


def lit_images(root: Path, numbers: Sequence[int], centers: Float64[np.ndarray, "cameras 3"], table: str) -> LitImages:
    """The lights of images.

    Those of `OLAT` by their number, of `PATTERNS` by a table that the user has to make.

    Args:
        centers: of the cameras, in the set's world.
        table: the setting import_capture.light_patterns.
    """
    if root.parent.name == OLAT:
        return _single_lights(root, numbers, centers)
    if not table:
        raise InputError(
            "import_capture.light_patterns: expected a csv of pattern, light, x, y, z, intensity, found none: the set "
            f"does not say which lights its patterns turn on, and its {LIGHTS} belongs to another calibration than "
            f"the cameras of {PATTERNS}"
        )
    return _patterns(root, numbers, centers, Path(table))


def _single_lights(root: Path, numbers: Sequence[int], centers: np.ndarray) -> LitImages:
    places = read_lights(root)
    if beyond := [number for number in numbers if number >= len(places)]:
        expected = f"folders 000 to {len(places) - 1:03d}, one for each row of {LIGHTS}"
        raise InputError(f"{root}/{VIEWS}: expected {expected}, found {listed(beyond)}")
    unit, said = unit_of_stage(centers, places, UNITS, str(root))
    names = [light_name(number) for number in range(len(places))]
    return LitImages(
        numbers, pd.DataFrame({"light": names, **dict(zip("xyz", places.T, strict=True))}),
        pd.DataFrame({"frame": list(numbers), "light": [names[number] for number in numbers], "intensity": 1.0}), unit,
        f"{LIGHTS}, its unit, the stage's radius, counted as a metre; intensity 1 each",
        "the number of an image's folder is that of its light", said,
    )  # fmt: skip


def read_lights(root: Path) -> Float64[np.ndarray, "lights 3"]:
    """Places of light_pos.npy.

    It lies in the set's folder, in that of its kind, or in the object's.

    Raises:
        InputError: if it is not there, or has no three finite numbers for each light.
    """
    there = [folder / LIGHTS for folder in (root, root.parent, root.parent.parent) if (folder / LIGHTS).is_file()]
    if not there:
        expected = "the lights' places, found none; the file is part of the release"
        raise InputError(f"{root.parent.parent / LIGHTS}: expected {expected}")
    try:
        places = np.load(there[0], allow_pickle=False).astype(np.float64)
    except (OSError, ValueError) as error:
        raise InputError(f"{there[0]}: expected an array, found: {error}") from error
    if places.ndim != 2 or places.shape[1] != 3 or not np.isfinite(places).all():
        raise InputError(f"{there[0]}: expected rows of three finite numbers, found an array of {places.shape}")
    return places


def _patterns(root: Path, numbers: Sequence[int], centers: np.ndarray, path: Path) -> LitImages:
    table = csv_columns(path, ("pattern", "light", "x", "y", "z", "intensity"))
    if missing := sorted(set(numbers) - set(table.pattern)):
        expected = "lights of all patterns with images"
        raise InputError(f"{path}: pattern: expected {expected}, found none of {shown(missing)}")
    lights = table.groupby("light", sort=True)[["x", "y", "z"]]
    places = lights.first()
    if (lights.nunique() > 1).any(axis=None):
        raise InputError(f"{path}: x, y, z: expected one place of each light, found several of some")
    unit, said = unit_of_stage(centers, places.to_numpy(np.float64), UNITS, str(root))
    rows = table[table.pattern.isin(numbers)].rename(columns={"pattern": "frame"})
    rows = rows.assign(light=[light_name(int(light)) for light in rows.light])
    named = places.reset_index().assign(light=[light_name(int(light)) for light in places.index])
    return LitImages(
        numbers, named, rows[["frame", "light", "intensity"]].reset_index(drop=True), unit,
        f"{path.name} of import_capture.light_patterns, in the world of these cameras", f"{path.name}", said,
    )  # fmt: skip
