"""What files of cameras by other programs have in common: images with a pose and a lens each, named by file."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath

import numpy as np

from pipeline.base.errors import InputError, listed
from pipeline.geometry.cameras import Camera

TERMS = ("k1", "k2", "p1", "p2", "k3")
FURTHER_TERMS = ("k4", "k5", "k6")


@dataclass(frozen=True)
class SourceImage:
    """One image of a file of cameras.

    Attributes:
        owner: the capture's camera that took it.
        name: what the file calls it.
        camera: its pose and lens, in the file's frame and unit of length; R as it stands there, perhaps no rotation.
            None if they are of no use, which is complained of.
    """

    owner: str
    name: str
    camera: Camera | None


def resolve_owner(image: str, cameras: Collection[str]) -> str | None:
    """The capture's camera that an image's name or its folder names exactly; None if neither does.

    Raises:
        InputError: if they name two.
    """
    place = PurePosixPath(image.replace("\\", "/"))
    named = {name for name in (place.stem, place.name, place.parent.name) if name in cameras}
    if len(named) > 1:
        found = f"the cameras {listed(sorted(named))}"
        raise InputError(f"image {image}: expected the name or the folder of one camera, found {found}; rename it")
    return next(iter(named), None)


def camera_from_terms(R: np.ndarray, t: np.ndarray, terms: Mapping[str, float], width: int, height: int) -> Camera:
    """A camera of OpenCV's model. `terms` has fx, fy, cx, cy in pixels (first centre at (0.5, 0.5)), and k1 k2 p1 p2 k3
    where they are not 0.

    Raises:
        InputError: if the terms are no lens, or one of more terms than these.
    """
    if further := [name for name in FURTHER_TERMS if terms.get(name, 0.0) != 0]:
        found = ", ".join(f"{name} of {terms[name]:g}" for name in further)
        raise InputError(f"distortion: expected k1, k2, p1, p2 and k3 only, found {found}; undistort the images")
    if not np.isfinite([*terms.values()]).all() or min(terms["fx"], terms["fy"], width, height) <= 0:
        found = ", ".join(f"{name} {value:g}" for name, value in terms.items())
        raise InputError(f"lens: expected finite numbers and positive focal lengths and sizes, found {found}")
    K = np.array([[terms["fx"], 0, terms["cx"]], [0, terms["fy"], terms["cy"]], [0, 0, 1.0]])
    return Camera(R, t, K, np.array([terms.get(name, 0.0) for name in TERMS]), width, height)
