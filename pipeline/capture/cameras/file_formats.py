"""The table of formats that cameras calibrated elsewhere come in, and what tells them apart.

Another format is a module beside this one, a line in `FORMATS`, and its name in `CAMERA_SUFFIXES` of the schema.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pipeline.base.errors import Complaints, InputError
from pipeline.base.files import read_json
from pipeline.capture.cameras.caliscope_cameras import is_caliscope, read_caliscope
from pipeline.capture.cameras.camera_formats import SourceImage
from pipeline.capture.cameras.easymocap_cameras import is_easymocap, read_easymocap
from pipeline.capture.cameras.metashape_cameras import is_metashape, read_metashape
from pipeline.capture.cameras.nerfstudio_cameras import read_nerfstudio
from pipeline.capture.cameras.opencv_cameras import is_opencv, read_opencv
from pipeline.capture.cameras.qualisys_cameras import is_qualisys, read_qualisys
from pipeline.geometry.cameras import read_cameras

log = logging.getLogger(__name__)

AUTO = "auto"

Sizes = Mapping[str, tuple[int, int]]
"""Width and height of the sensor of every camera of the capture, pixels."""


@dataclass(frozen=True)
class CameraFormat:
    """A format of files of cameras.

    Attributes:
        content: what such a file or folder is, for messages.
        recognise: tells from the file or folder alone whether it is of this format.
        read: the images, or the cameras, that are those of `Sizes`; complaints name the others.
        unit: what a camera of the capture is named after: an image, a section or an entry of the file.
    """

    content: str
    recognise: Callable[[Path], bool]
    read: Callable[[Path, Sizes, Complaints], list[SourceImage]]
    unit: Literal["image", "section", "entry"] = "section"


def _read_own(path: Path, cameras: Sizes, complaints: Complaints) -> list[SourceImage]:
    return [SourceImage(name, name, camera) for name, camera in read_cameras(path).items()]


def _read_colmap(path: Path, cameras: Sizes, complaints: Complaints) -> list[SourceImage]:
    # Imports pycolmap, which loads all of COLMAP.
    from pipeline.capture.cameras.colmap_cameras import read_colmap

    return read_colmap(path, cameras, complaints)


def _is_colmap(path: Path) -> bool:
    return any(all((path / f"{table}.{kind}").is_file() for table in ("cameras", "images")) for kind in ("bin", "txt"))


def _has_key(key: str, kind: type) -> Callable[[Path], bool]:
    """Recognise JSON files by a key and the type of its value."""

    def recognise(path: Path) -> bool:
        if path.suffix.lower() != ".json" or not path.is_file():
            return False
        try:
            content = read_json(path)
        except InputError:
            return False
        return isinstance(content, dict) and isinstance(content.get(key), kind)

    return recognise


FORMATS: dict[str, CameraFormat] = {
    "cameras_json": CameraFormat("a .json with the key cameras", _has_key("cameras", dict), _read_own, "entry"),
    "colmap": CameraFormat("a folder with cameras and images as .bin or .txt", _is_colmap, _read_colmap, "image"),
    "nerfstudio": CameraFormat("a .json with the key frames", _has_key("frames", list), read_nerfstudio, "image"),
    "caliscope": CameraFormat("a .toml with sections cameras.0 or cam_0", is_caliscope, read_caliscope),
    "metashape": CameraFormat("an .xml with the root document", is_metashape, read_metashape, "image"),
    "qualisys": CameraFormat("QTM's .txt or .xml with the root calibration", is_qualisys, read_qualisys),
    "easymocap": CameraFormat("a folder with intri.yml and extri.yml", is_easymocap, read_easymocap),
    "opencv": CameraFormat("FileStorage of a rig, or a folder of a file per camera", is_opencv, read_opencv),
}


def resolve_format(name: str, path: Path) -> CameraFormat:
    """The format of this name; of `AUTO`, the only one that recognises the path.

    Raises:
        InputError: if none or several do.
    """
    if name != AUTO:
        return FORMATS[name]
    if not path.exists():
        raise InputError("expected a file or folder of cameras, found none")
    found = [key for key, camera_format in FORMATS.items() if camera_format.recognise(path)]
    if len(found) == 1:
        log.info("%s: its format is %s", path.name, found[0])
        return FORMATS[found[0]]
    if found:
        hint = "say which as calibration.cameras.format, or leave one there"
        raise InputError(f"format: expected cameras of one format, found what may be {' or '.join(found)}; {hint}")
    known = "; ".join(f"{key}: {camera_format.content}" for key, camera_format in FORMATS.items())
    raise InputError(f"format: expected one that is known ({known}), found none of them; say which it is meant to be")
