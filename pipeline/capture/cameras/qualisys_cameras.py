"""Reading cameras from calibrations that Qualisys Track Manager exports.

They are XML, in a .txt or .xml. Lengths are millimetres and become metres; image coordinates are subpixels, 1/64 pixel,
and fields of view pixels (QTM real-time protocol, Video_Res and Video_FOV). `sensorMinU` is 0 and `sensorMaxU` 64 times
the width less 1: pixel i has the subpixels 64 i to 64 i + 63, so subpixel s lies at (s + 0.5) / 64 from the sensor's
edge. Programs that hand `centerPointU` / 64 to OpenCV put it half a pixel further; Qualisys does not say.

`x`, `y`, `z` are the camera's place, and the rows r11 r12 r13, r21 r22 r23, r31 r32 r33 its axes in the world: right,
up and backward. So Pose2Sim reads them (read_qca, then half a turn about x), and so the optical axes of six published
cameras (of QTM in 2020) pass one point, 1.3 to 1.7 m ahead, within 97 mm; with columns for rows they miss it by 652 mm.
Distortion is OpenCV's k1 k2 p1 p2 k3 and has no unit: to divide it by 64, too, as Pose2Sim does, loses it.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from pipeline.base.errors import Complaints, InputError
from pipeline.capture.cameras.camera_formats import SourceImage, SourceLens, camera_from_lens, finite_numbers
from pipeline.capture.cameras.xml_documents import has_root, read_xml
from pipeline.geometry.cameras import Camera
from pipeline.geometry.lenses import BROWN_CONRADY

SUBPIXELS = 64
SUBPIXEL_CENTER = 0.5
METRES_PER_UNIT = 0.001
OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0])
DISTORTION = {"k1": "radialDistortion1", "k2": "radialDistortion2", "k3": "radialDistortion3",
              "p1": "tangentalDistortion1", "p2": "tangentalDistortion2"}  # fmt: skip
"""The file's names, and their spelling."""

ROOT, MARK = "calibration", "qtm-version"
"""Theia's files have the same root without this attribute; their transform is camera-from-world."""


def is_qualisys(file: Path) -> bool:
    """Tell whether this is a calibration exported by QTM."""
    return file.suffix.lower() in (".txt", ".xml") and has_root(file, ROOT, MARK)


def read_qualisys(file: Path, cameras: Collection[str], complaints: Complaints) -> list[SourceImage]:
    """The active cameras, by serial number. Those that are none of the capture's may be anything.

    Raises:
        InputError: if the file is no calibration of QTM.
    """
    root = read_xml(file)
    if root.tag != ROOT or MARK not in root.attrib:
        hint = "export the calibration from QTM; files of Theia look alike, but hold other transforms"
        raise InputError(f"{ROOT}: expected a calibration with the attribute {MARK}, found {root.tag} without; {hint}")
    found = []
    for entry in root.iterfind("cameras/camera"):
        name, camera = entry.get("serial", ""), None
        if entry.get("active", "1") == "0":
            continue
        with complaints.collecting():
            if name in cameras:
                camera = _camera(f"camera {name}", entry)
        found.append(SourceImage(name, name, camera))
    return found


def _camera(where: str, entry: Element) -> Camera:
    try:
        if entry.get("viewrotation", "0") == "180":
            hint = "set it to 0 in QTM, or turn the images back and write 0 here, if they were exported turned"
            raise InputError(f"viewrotation: expected 0, 90 or 270, found 180; {hint}")
        pose = _part(entry, "transform")
        rows = [[f"r{row}{column}" for column in (1, 2, 3)] for row in (1, 2, 3)]
        R = OPENCV_FROM_OPENGL @ np.array([[float(finite_numbers(pose, key, ())) for key in row] for row in rows])
        center = METRES_PER_UNIT * np.array([float(finite_numbers(pose, key, ())) for key in "xyz"])
        return camera_from_lens(R, -R @ center, _lens(entry))
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def _lens(entry: Element) -> SourceLens:
    values = _part(entry, "intrinsic")
    for key in ("sensorMinU", "sensorMinV", "skew"):
        if key in values and float(finite_numbers(values, key, ())) != 0:
            raise InputError(f"{key}: expected 0, found {values[key]}")
    left, top, width, height = _field_of_view(entry, values)
    terms = {name: float(finite_numbers(values, key, ())) for name, key in DISTORTION.items() if key in values}
    for axis, edge in (("U", left), ("V", top)):
        at = (float(finite_numbers(values, f"centerPoint{axis}", ())) + SUBPIXEL_CENTER) / SUBPIXELS - edge
        f = float(finite_numbers(values, f"focalLength{axis}", ())) / SUBPIXELS
        terms |= {"fx": f, "cx": at} if axis == "U" else {"fy": f, "cy": at}
    return SourceLens(BROWN_CONRADY, terms, width, height)


def _field_of_view(entry: Element, intrinsic: dict[str, str]) -> tuple[int, int, int, int]:
    """Left and top of the video within the sensor, and its size, pixels; all of the sensor where none is given."""
    if entry.find("fov_video") is None:
        size = [(float(finite_numbers(intrinsic, f"sensorMax{axis}", ())) + 1) / SUBPIXELS for axis in "UV"]
        edges = [0.0, 0.0, size[0] - 1, size[1] - 1]
    else:
        view = _part(entry, "fov_video")
        edges = [float(finite_numbers(view, key, ())) for key in ("left", "top", "right", "bottom")]
    if any(edge % 1 for edge in edges):
        raise InputError(f"fov_video: expected whole pixels, found {edges}")
    left, top, right, bottom = map(int, edges)
    return left, top, right - left + 1, bottom - top + 1


def _part(entry: Element, tag: str) -> dict[str, str]:
    part = entry.find(tag)
    if part is None:
        raise InputError(f"{tag}: expected such a part, found none; export the whole calibration")
    return dict(part.attrib)
