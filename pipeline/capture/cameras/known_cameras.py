"""Cameras that were calibrated elsewhere.

Read in the format they are in, checked, and brought to metres.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from pipeline.base.errors import Complaints, InputError, listed
from pipeline.base.files import digest_bytes, digest_file
from pipeline.capture.cameras.camera_formats import SourceImage
from pipeline.capture.cameras.file_formats import AUTO, CameraFormat, resolve_format
from pipeline.capture.paths import locate
from pipeline.capture.schema.camera_schema import CAMERA_SUFFIXES, CameraFile, KnownCameras
from pipeline.geometry.cameras import Camera

ROTATION_TOLERANCE = 1e-4
"""Largest entry of R R^T - I: a rotation written with five digits passes, a scaled or mirrored one does not."""

AGREEMENT_PX = 0.1
"""Pixels by which the poses and lenses of one camera's images may differ: about what a good calibration leaves open."""

AGREEMENT_DISTANCES_M = (0.5, 5.0)
"""Where that is measured: a stage's subjects and walls are between these."""

FOLDERS = {"colmap": "the folder of a COLMAP model", "easymocap": "the folder of intri.yml and extri.yml"}
"""Formats that are folders, and what to expect there."""


def digest_known_cameras(root: Path, section: CameraFile) -> str:
    """Digest of the file, or of the names and contents of all files of a folder.

    Raises:
        InputError: if there is nothing of this name in the capture.
    """
    if not (root / section.path).is_dir():
        if section.format in FOLDERS:
            raise InputError(f"{section.path}: expected {FOLDERS[section.format]}, found none")
        return digest_file(locate(root, section.path))
    if section.format != AUTO and CAMERA_SUFFIXES[section.format] is not None:
        raise InputError(f"{section.path}: expected a file, found a folder")
    names = sorted(file.name for file in (root / section.path).iterdir() if not file.is_dir())
    lines = [f"{digest_file(locate(root, f'{section.path}/{name}'))} {name}" for name in names]
    return digest_bytes("\n".join(lines).encode())


def read_known_cameras(
    root: Path,
    section: KnownCameras,
    sizes: Mapping[str, tuple[int, int]],
    complaints: Complaints,
    *,
    posed: bool = True,
) -> dict[str, Camera]:
    """The capture's cameras, in metres, their frame as it is given.

    Args:
        sizes: width and height of the sensor of every camera of the capture, pixels.
        posed: whether poses count; otherwise a lens is enough.
    """
    inner = Complaints(section.path)
    try:
        camera_format = resolve_format(section.format, root / section.path)
        images = camera_format.read(root / section.path, sizes, inner)
    except InputError as error:
        images = None
        inner.messages.append(str(error).removeprefix(f"{root / section.path}: "))
    complaints.messages += [f"{section.path}: {message}" for message in dict.fromkeys(inner.messages)]
    if images is None:
        return {}
    if section.frame == "own":
        images = _of_moved_rig(images)
    cameras = {}
    for name, size in sizes.items():
        mine = [image for image in images if image.owner == name]
        if not mine:
            others = [image.name for image in images if image.owner not in sizes]
            _complain_missing(camera_format, section.path, name, others, complaints)
            continue
        mine = [image for image in mine if image.camera is not None]
        # A list: every image is to be checked.
        if mine and False not in [_check(section.path, image, size, posed, complaints) for image in mine]:
            scaled = [replace(image, camera=_in_metres(image.camera, section.scale_to_m)) for image in mine]
            if not posed:
                scaled = [replace(image, camera=replace(image.camera, R=np.eye(3), t=np.zeros(3))) for image in scaled]
            _check_agreement(section.path, scaled, complaints)
            cameras[name] = scaled[0].camera
    return cameras


def read_known_lenses(
    root: Path, section: CameraFile, lens: str, sizes: Mapping[str, tuple[int, int]], complaints: Complaints
) -> dict[str, Camera]:
    """Cameras of `sizes` from a file of which only the lenses count, all of one model."""
    file = KnownCameras(method="known", **section.model_dump())
    cameras = read_known_cameras(root, file, sizes, complaints, posed=False)
    for name, camera in cameras.items():
        if camera.lens.name != lens:
            hint = "set calibration.cameras.lens to the lens of the file"
            complaints.add(file.path, f"{name}: lens", expected=lens, found=camera.lens.name, hint=hint)
    return cameras


def _of_moved_rig(images: list[SourceImage]) -> list[SourceImage]:
    """Images in the frame of their rig, if it moved while they were taken: its cameras then have no place in the world.

    A rig that stood still is left in the world that the file has.
    """
    mine = [image for image in images if image.camera is not None]
    if not mine or any(image.on_rig is None for image in mine):
        return images
    first = {image.owner: image for image in reversed(mine)}
    if max(_difference_px(first[image.owner].camera, image.camera) for image in mine) <= AGREEMENT_PX:
        return images
    return [replace(image, camera=image.on_rig) for image in images]


def _complain_missing(
    camera_format: CameraFormat, path: str, name: str, others: list[str], complaints: Complaints
) -> None:
    if camera_format.unit == "entry":
        complaints.add(path, name, expected="every camera of the table of cameras", found="no entry")
    elif camera_format.unit == "section":
        found = f"none; cameras of the file that no camera of the capture is named after: {listed(others) or 'none'}"
        hint = "name the capture's cameras after the file's"
        complaints.add(path, name, expected="a section of this name", found=found, hint=hint)
    else:
        expected = f"an image with a pose that is called {name} or lies in a folder {name}"
        complaints.add(path, name, expected=expected, found="none")


def _check(path: str, image: SourceImage, size: tuple[int, int], posed: bool, complaints: Complaints) -> bool:
    """Sensor's size and a rotation, or complaints."""
    camera, before = image.camera, len(complaints.messages)
    key = image.owner if image.name == image.owner else f"{image.owner}: image {image.name}"
    if posed and not image.posed:
        hint = "add it, or calibrate with boards and take this file as lenses_from"
        complaints.add(path, key, expected="a pose, R and T", found="a lens alone", hint=hint)
        return False
    if (camera.width, camera.height) != size:
        expected, found = f"the sensor's {size[0]} x {size[1]}", f"{camera.width} x {camera.height}"
        hint = "" if camera.width * size[1] != camera.height * size[0] else (
            f"multiply its f and c (pixels) by {size[0] / camera.width:g} and give the sensor's size"
        )  # fmt: skip
        complaints.add(path, f"{key}: width x height", expected=expected, found=found, hint=hint)
    error = float(np.abs(camera.R @ camera.R.T - np.eye(3)).max())
    if error > ROTATION_TOLERANCE or np.linalg.det(camera.R) < 0:
        found = "a mirrored one" if error <= ROTATION_TOLERANCE else f"rows off by {error:.2g}"
        complaints.add(path, f"{key}: R", expected="a rotation (orthonormal, right-handed)", found=found)
    return len(complaints.messages) == before


def _in_metres(camera: Camera, scale: float) -> Camera:
    """The rotation nearest to R, and t in metres."""
    left, _, right = np.linalg.svd(camera.R)
    R = left @ right
    return replace(camera, R=R, t=scale * (R @ camera.R.T @ camera.t))


def _check_agreement(path: str, images: list[SourceImage], complaints: Complaints) -> None:
    """A camera of a stage stands still: all its images must have one pose and lens."""
    differences = [_difference_px(images[0].camera, image.camera) for image in images]
    worst = int(np.argmax(differences))
    if differences[worst] > AGREEMENT_PX:
        expected = f"one pose and lens for all of its {len(images)} images"
        found = f"{images[0].name} and {images[worst].name} {differences[worst]:.2f} px apart"
        hint = "calibrate the stage's cameras as a rig that does not move, or keep one image per camera"
        hint += "; a rig that moved needs frame: own" if images[0].on_rig is not None else ""
        complaints.add(path, images[0].owner, expected=expected, found=found, hint=hint)


def _difference_px(a: Camera, b: Camera) -> float:
    """Pixels between where two cameras put points that a sees in the middle half of its image."""
    x, y = np.meshgrid(a.width * np.array([0.25, 0.5, 0.75]), a.height * np.array([0.25, 0.5, 0.75]))
    pixels = np.stack([x.ravel(), y.ravel()], 1)
    rays = a.ray_directions(pixels)
    pixels, rays = pixels[np.isfinite(rays).all(1)], rays[np.isfinite(rays).all(1)]
    away = []
    for distance in AGREEMENT_DISTANCES_M:
        seen, _ = b.project(a.center + distance * rays)
        away.append(np.where(b.sees(a.center + distance * rays), np.linalg.norm(seen - pixels, axis=1), np.inf))
    return float(np.max(away))
