"""Tables of OLATverse: cameras, lights and the benchmark's split."""

from __future__ import annotations

import logging
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float64

from pipeline.base.errors import Complaints, InputError
from pipeline.datasets.imported_capture import HeldOut
from pipeline.datasets.layout import json_key
from pipeline.datasets.light_durations import light_name
from pipeline.datasets.stage_units import unit_of_stage

log = logging.getLogger(__name__)

CAMERAS, LIGHTS = "all_cam.json", "all_lights.json"
SPLITS = ("transforms_train.json", "transforms_test.json")

UNITS = {0.001: "millimetres", 1.0: "metres"}
"""Units that the set may mean: those of HumanOLAT, from the same stage, are millimetres, those of its lights metres."""

TEST_CAMERAS = ("Cam01", "Cam06", "Cam13", "Cam19", "Cam27", "Cam35")
BENCHMARKED, TRAIN_STEP = 310, 3
"""The benchmark's split, for objects that come without its files: of the first 310 lights every third trains, from the
first, and tests, from the second."""


@dataclass(frozen=True)
class WrittenPose:
    """One camera as the file has it.

    Attributes:
        world_from_camera: in axes and a unit that the file does not say.
        K: pixels, counted from the corner.
    """

    world_from_camera: Float64[np.ndarray, "4 4"]
    K: Float64[np.ndarray, "3 3"]


@dataclass(frozen=True)
class ListedLights:
    """Lights by number, which is the order of firing.

    Attributes:
        places: metres, y up.
        intensities: of each.
        image_of: number of the image that shows it alone.
    """

    places: Mapping[int, Float64[np.ndarray, " 3"]]
    intensities: Mapping[int, float]
    image_of: Mapping[int, int]

    def table(self) -> pd.DataFrame:
        """light, x, y, z."""
        places = np.array(list(self.places.values()))
        return pd.DataFrame({"light": list(map(light_name, self.places)), **dict(zip("xyz", places.T, strict=True))})


@dataclass(frozen=True)
class Split:
    """Cameras that test, and lights that test or train; the others validate.

    Attributes:
        origin: where the split is from.
        image_of: of each light.
    """

    cameras: Sequence[str]
    test: Collection[int]
    train: Collection[int]
    origin: str
    image_of: Mapping[int, int]

    def held_out(self, frames: Collection[int]) -> HeldOut:
        """The split of some images."""
        shown_by = {light: number for light, number in self.image_of.items() if number in frames}
        test = [number for light, number in shown_by.items() if light in self.test]
        spare = [number for light, number in shown_by.items() if light not in self.test and light not in self.train]
        return HeldOut(self.cameras, patterns=test, validation_patterns=spare)


def read_poses(path: Path) -> dict[str, WrittenPose]:
    """Cameras of all_cam.json by name.

    Raises:
        InputError: naming all that have no pose or no lens.
    """
    complaints, found = Complaints(path), {}
    for number, entry in enumerate(json_key(path, "frames")):
        name = camera_name(entry)
        pose, lens = numbers(entry, "transform_matrix", (4, 4)), numbers(entry, "camera_intrinsics", (4,))
        if name is None or pose is None or lens is None:
            expected = "cam_idx, transform_matrix of 4 x 4 and camera_intrinsics cx, cy, fx, fy, finite"
            complaints.add(path.name, f"frames[{number}]", expected=expected, found=f"{entry!r:.80}")
            continue
        cx, cy, fx, fy = lens
        found[name] = WrittenPose(pose, np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]))
    complaints.raise_if_any()
    return found


def read_lights(path: Path) -> ListedLights:
    """Lights of all_lights.json; entries repeat.

    Raises:
        InputError: naming entries that are incomplete, coloured, or say something else of a light than an earlier one.
    """
    complaints, found = Complaints(path), {}
    for number, entry in enumerate(json_key(path, "frames")):
        place, shade = numbers(entry, "pl_pos", (3,)), numbers(entry, "pl_intensity", (3,))
        image = re.fullmatch(r".*\.(\d+)", str(entry.get("file_path"))) if isinstance(entry, dict) else None
        light = entry.get("light_idx") if isinstance(entry, dict) else None
        white = shade is not None and np.ptp(shade) == 0 and shade[0] > 0
        if place is None or not white or image is None or not isinstance(light, int):
            expected = "file_path <object>.<image>, light_idx, pl_pos, and pl_intensity of three equal numbers above 0"
            complaints.add(path.name, f"frames[{number}]", expected=expected, found=f"{entry!r:.80}")
            continue
        said = (tuple(place.tolist()), float(shade[0]), int(image[1]))
        if found.setdefault(light, said) != said:
            found_later = f"{said} in a later entry"
            complaints.add(path.name, f"light_idx {light}", expected=str(found[light]), found=found_later)
    complaints.raise_if_any()
    images = [image for _, _, image in found.values()]
    if len(set(images)) != len(images):
        raise InputError(f"{path}: file_path: expected an image for each light, found one of two lights")
    places, shades, shown_by = ({light: said[k] for light, said in sorted(found.items())} for k in range(3))
    log.info("%s: %d lights", path, len(found))
    return ListedLights({light: np.array(place) for light, place in places.items()}, shades, shown_by)


def chosen_unit(poses: Mapping[str, WrittenPose], places: Mapping[int, np.ndarray], where: str) -> tuple[float, str]:
    """Metres per unit of the cameras' poses, and why: cameras stand among the lights."""
    centers = np.array([pose.world_from_camera[:3, 3] for pose in poses.values()])
    return unit_of_stage(centers, np.array(list(places.values())), UNITS, where)


def read_split(root: Path, names: Sequence[str], lights: ListedLights) -> Split:
    """The benchmark's split: of the object's own files, else the one published for all."""
    if all((root / name).is_file() for name in SPLITS):
        listed = []
        for name in SPLITS:
            entries = json_key(root / name, "frames")
            listed.append(({camera_name(entry) for entry in entries}, {entry.get("light_idx") for entry in entries}))
        (trained, train), (tested, test) = listed
        origin = f"cameras and lights that only {SPLITS[1]} has test; lights in neither file validate"
        tested, test = tested - trained, test - train
    else:
        tested, test = set(TEST_CAMERAS), set(range(1, BENCHMARKED, TRAIN_STEP))
        train = set(range(0, BENCHMARKED, TRAIN_STEP))
        origin = (
            f"that of the benchmark: cameras {', '.join(TEST_CAMERAS)}; of the first {BENCHMARKED} lights [1::3] test, "
            "[0::3] train, all others validate"
        )
    cameras = [name for name in names if name in tested]
    return Split(cameras if len(cameras) < len(names) else [], test, train, origin, lights.image_of)


def camera_name(entry: Any) -> str | None:
    """Name of the camera's folder: cam_idx is the name, or its number."""
    index = entry.get("cam_idx") if isinstance(entry, dict) else None
    if isinstance(index, int):
        return f"Cam{index:02d}"
    return index if isinstance(index, str) else None


def numbers(entry: Any, key: str, shape: tuple[int, ...]) -> np.ndarray | None:
    """Finite numbers of a key of an entry; None if there are others."""
    try:
        found = np.asarray(entry[key], np.float64)
    except (KeyError, TypeError, ValueError):
        return None
    return found if found.shape == shape and np.isfinite(found).all() else None
