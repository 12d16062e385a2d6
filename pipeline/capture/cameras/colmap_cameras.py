"""Reading cameras from COLMAP's sparse models, text or binary, and writing them.

COLMAP's conventions are this project's: poses are camera-from-world, x right, y down, z forward, and the first pixel's
centre is (0.5, 0.5). Its perspective lenses and those of its fisheyes that are named here distort as OpenCV does.
Cameras on a rig are sensors: a frame has the rig's pose at one moment, and sensor-from-rig is the same in all frames
(COLMAP's documentation, Rig support).
"""

from __future__ import annotations

import tempfile
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Literal

import numpy as np
import pycolmap

from pipeline.base.errors import Complaints, InputError
from pipeline.capture.cameras.camera_formats import SourceImage, SourceLens, camera_from_lens, resolve_owner
from pipeline.capture.cameras.colmap_tables import check_whole
from pipeline.geometry.cameras import Camera
from pipeline.geometry.lenses import BROWN_CONRADY, FISHEYE

PERSPECTIVE = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV")
"""COLMAP's models that k1 k2 p1 p2 k3 express exactly; the last one if its k4 to k6 are 0."""

FISHEYES = ("SIMPLE_FISHEYE", "FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "OPENCV_FISHEYE")
"""COLMAP's models that a fisheye's k1 k2 k3 k4 express exactly."""

MODELS = {**dict.fromkeys(PERSPECTIVE, BROWN_CONRADY), **dict.fromkeys(FISHEYES, FISHEYE)}

WRITTEN_MODELS = {BROWN_CONRADY: "FULL_OPENCV", FISHEYE: "OPENCV_FISHEYE"}
"""COLMAP's model of every lens; `OPENCV`, which more programs read, stands for the first where its k3 is 0."""

OPENCV_TERMS = {"f": "fx", "k": "k1"}
"""COLMAP's names of terms where they differ from OpenCV's; a single f is fy too."""

TABLES = ("cameras", "images")
RIG_TABLES = ("rigs", "frames")
"""What stands in a model beside its points: since COLMAP 3.12, also where cameras sit on a rig."""

NO_POINTS = {"bin": bytes(8), "txt": b""}
"""A table of no points, by the kind of model: points are of no use here, and there may be millions."""

READING_ERRORS = (ValueError, LookupError, RuntimeError, MemoryError, OSError)
"""What pycolmap raises on files that are not what they should be."""


def read_colmap(folder: Path, cameras: Collection[str], complaints: Complaints) -> list[SourceImage]:
    """The images of a model that the capture's cameras took, by name. Images of other cameras may be anything.

    Raises:
        InputError: if the folder is no model, or not a whole one.
    """
    found, model = [], _read_model(folder)
    on_one_rig = len(model.rigs) == 1 and all(_camera_count(rig) > 1 for rig in model.rigs.values())
    for image in sorted(model.images.values(), key=lambda image: image.name):
        owner, camera, on_rig = None, None, None
        with complaints.collecting():
            owner = resolve_owner(image.name, cameras)
            if owner is not None and image.has_pose:
                camera = read_image_camera(image, image.cam_from_world())
                on_rig = read_image_camera(image, _sensor_from_rig(image)) if on_one_rig else None
        if owner is not None and image.has_pose:
            found.append(SourceImage(owner, image.name, camera, on_rig=on_rig))
    return found


def _camera_count(rig: pycolmap.Rig) -> int:
    return sum(sensor.type == pycolmap.SensorType.CAMERA for sensor in rig.sensor_ids())


def _sensor_from_rig(image: pycolmap.Image) -> pycolmap.Rigid3d:
    rig, sensor = image.frame.rig, image.camera.sensor_id
    return pycolmap.Rigid3d() if rig.is_ref_sensor(sensor) else rig.sensor_from_rig(sensor)


def _read_model(folder: Path) -> pycolmap.Reconstruction:
    """The model without its points.

    Raises:
        InputError: if it is none, or truncated.
    """
    kinds = [kind for kind in NO_POINTS if all((folder / f"{table}.{kind}").is_file() for table in TABLES)]
    if len(kinds) != 1:
        found = "both; remove one" if kinds else "no such files" if folder.is_dir() else "no such folder"
        raise InputError(f"expected a COLMAP model, {', '.join(TABLES)} as .bin or as .txt, found {found}")
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        for table in TABLES + RIG_TABLES:
            if (file := folder / f"{table}.{kinds[0]}").is_file():
                if kinds == ["bin"]:
                    check_whole(file)
                (scratch / file.name).symlink_to(file.resolve())
        (scratch / f"points3D.{kinds[0]}").write_bytes(NO_POINTS[kinds[0]])
        try:
            return pycolmap.Reconstruction(scratch)
        except READING_ERRORS as error:
            raise InputError(f"expected a whole COLMAP model, found: {error}") from error


def read_image_camera(image: pycolmap.Image, from_frame: pycolmap.Rigid3d) -> Camera:
    """Camera of one image of a model.

    Raises:
        InputError: if its lens is none of those that are known here.
    """
    lens, pose = image.camera, np.asarray(from_frame.matrix())
    where = f"image {image.name}: COLMAP camera {lens.camera_id}"
    if lens.model_name not in MODELS:
        hint = "calibrate with one of those, or undistort the images"
        raise InputError(f"{where}: model: expected one of {', '.join(MODELS)}, found {lens.model_name}; {hint}")
    names = [OPENCV_TERMS.get(name, name) for name in lens.params_info.split(", ")]
    if len(names) != len(lens.params):
        raise InputError(f"{where}: expected the parameters {lens.params_info}, found {len(lens.params)} numbers")
    terms = dict(zip(names, map(float, lens.params), strict=True))
    terms.setdefault("fy", terms["fx"])
    try:
        given = SourceLens(MODELS[lens.model_name], terms, int(lens.width), int(lens.height))
        return camera_from_lens(pose[:, :3], pose[:, 3], given)
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def write_colmap(folder: Path, cameras: Mapping[str, Camera], kind: Literal["binary", "text"] = "binary") -> None:
    """Write cameras as a COLMAP model without points.

    One image `<name>.png` for each, on a rig of its own.
    """
    made = pycolmap.Reconstruction()
    for number, (name, camera) in enumerate(cameras.items(), 1):
        made.add_camera_with_trivial_rig(colmap_lens(number, camera))
        image = pycolmap.Image(name=f"{name}.png", camera_id=number, image_id=number)
        made.add_image_with_trivial_frame(image, _pose(camera))
    _write(made, folder, kind)


def write_colmap_rig(
    folder: Path,
    cameras: Mapping[str, Camera],
    images: Mapping[int, Mapping[str, str]],
    kind: Literal["binary", "text"] = "binary",
) -> None:
    """Write a COLMAP model without points whose cameras are the sensors of one rig.

    The rig stands still: each frame has the same pose of it.

    Args:
        cameras: the first is the rig's reference.
        images: name of each camera's image, by frame: a frame of the model each.
    """
    made, rig, numbers = pycolmap.Reconstruction(), pycolmap.Rig(rig_id=1), {}
    rig_from_world = _pose(next(iter(cameras.values())))
    for number, (name, camera) in enumerate(cameras.items(), 1):
        made.add_camera(colmap_lens(number, camera))
        numbers[name] = number
        if number == 1:
            rig.add_ref_sensor(made.camera(number).sensor_id)
        else:
            rig.add_sensor(made.camera(number).sensor_id, _pose(camera) * rig_from_world.inverse())
    made.add_rig(rig)
    image_id = 0
    for frame_id, named in enumerate((images[number] for number in sorted(images)), 1):
        frame = pycolmap.Frame(frame_id=frame_id, rig_id=1, rig_from_world=rig_from_world)
        ids = {name: image_id + k for k, name in enumerate(named, 1)}
        image_id += len(named)
        for name, key in ids.items():
            frame.add_data_id(pycolmap.data_t(made.camera(numbers[name]).sensor_id, key))
        made.add_frame(frame)
        for name, key in ids.items():
            image = pycolmap.Image(name=named[name], camera_id=numbers[name], image_id=key)
            image.frame_id = frame_id
            made.add_image(image)
        made.register_frame(frame_id)
    _write(made, folder, kind)


def colmap_lens(number: int, camera: Camera) -> pycolmap.Camera:
    """A camera's lens as COLMAP numbers and models it."""
    model = WRITTEN_MODELS[camera.lens]
    if model == "FULL_OPENCV" and camera.dist[-1] == 0:
        model = "OPENCV"
    lens = pycolmap.Camera(camera_id=number, model=model, width=camera.width, height=camera.height)
    terms = dict(zip(("fx", "fy", "cx", "cy"), camera.K[[0, 1, 0, 1], [0, 1, 2, 2]], strict=True))
    terms |= dict(zip(camera.lens.terms, camera.dist, strict=True))
    lens.params = [float(terms.get(term, 0.0)) for term in lens.params_info.split(", ")]
    return lens


def _pose(camera: Camera) -> pycolmap.Rigid3d:
    return pycolmap.Rigid3d(pycolmap.Rotation3d(camera.R), camera.t)


def _write(made: pycolmap.Reconstruction, folder: Path, kind: str) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    getattr(made, f"write_{kind}")(folder)
