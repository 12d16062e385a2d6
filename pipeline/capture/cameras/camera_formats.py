"""Common parts of other programs' files of cameras.

Images with a pose and a lens each, named by file.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any

import numpy as np
from jaxtyping import Float64

from pipeline.base.errors import InputError, listed
from pipeline.geometry.cameras import Camera
from pipeline.geometry.lens import Lens

PINHOLE = ("fx", "fy", "cx", "cy")

FURTHER_TERMS = ("k4", "k5", "k6")
"""OpenCV's names of terms that its perspective lens may have beyond `BROWN_CONRADY`."""


@dataclass(frozen=True)
class SourceImage:
    """One image of a file of cameras.

    Attributes:
        owner: the capture's camera that took it.
        name: what the file calls it.
        camera: its pose and lens, in the file's frame and unit of length; R as it stands there, perhaps no rotation.
            None if they are of no use, which is complained of.
        posed: False if the file has a lens alone; R and t then mean nothing.
        on_rig: the same in the frame of the one rig that all cameras of the file sit on; None without such a rig.
    """

    owner: str
    name: str
    camera: Camera | None
    posed: bool = True
    on_rig: Camera | None = None


def finite_numbers(values: Mapping[str, Any], key: str, shape: tuple[int, ...]) -> np.ndarray:
    """Numbers of an entry, float64; a column counts as a list.

    Raises:
        InputError: if there are none, others, or too few or many.
    """
    try:
        numbers = np.asarray(values[key], np.float64)
    except (KeyError, TypeError, ValueError):  # none, text, or rows of unequal length
        numbers = np.array([np.nan])
    if len(shape) == 1 and numbers.size == shape[0]:
        numbers = numbers.reshape(shape)
    if numbers.shape != shape or not np.isfinite(numbers).all():
        expected = f"{' x '.join(map(str, shape))} finite numbers" if shape else "a finite number"
        found = values.get(key, "none")
        found = found.tolist() if isinstance(found, np.ndarray) else found
        raise InputError(f"{key}: expected {expected}, found {found}")
    return numbers


def resolve_owner(image: str, cameras: Collection[str]) -> str | None:
    """The capture's camera that an image's name or its folder names exactly; None without one.

    Raises:
        InputError: if they name two.
    """
    place = PurePosixPath(image.replace("\\", "/"))
    named = {name for name in (place.stem, place.name, place.parent.name) if name in cameras}
    if len(named) > 1:
        found = f"the cameras {listed(sorted(named))}"
        raise InputError(f"image {image}: expected the name or the folder of one camera, found {found}; rename it")
    return next(iter(named), None)


@dataclass(frozen=True)
class SourceLens:
    """Intrinsics as a file of cameras has them.

    Attributes:
        model: the lens.
        terms: fx, fy, cx, cy in pixels (first centre at (0.5, 0.5)), and the lens's terms by OpenCV's names where they
            are not 0.
    """

    model: Lens
    terms: Mapping[str, float]
    width: int
    height: int


def camera_from_lens(R: Float64[np.ndarray, "3 3"], t: Float64[np.ndarray, " 3"], lens: SourceLens) -> Camera:
    """A camera of one of OpenCV's models.

    Raises:
        InputError: if the terms are no lens, or one of more terms than the model's.
    """
    terms, known = lens.terms, lens.model.terms
    if further := [name for name in terms if name not in (*PINHOLE, *known) and terms[name] != 0]:
        found = ", ".join(f"{name} of {terms[name]:g}" for name in further)
        expected = f"{', '.join(known[:-1])} and {known[-1]} only"
        raise InputError(f"distortion: expected {expected}, found {found}; undistort the images")
    if not np.isfinite([*terms.values()]).all() or min(terms["fx"], terms["fy"], lens.width, lens.height) <= 0:
        found = ", ".join(f"{name} {value:g}" for name, value in terms.items())
        raise InputError(f"lens: expected finite numbers and positive focal lengths and sizes, found {found}")
    K = np.array([[terms["fx"], 0, terms["cx"]], [0, terms["fy"], terms["cy"]], [0, 0, 1.0]])
    dist = np.array([terms.get(name, 0.0) for name in known])
    return Camera(R, t, K, dist, lens.width, lens.height, lens.model)
