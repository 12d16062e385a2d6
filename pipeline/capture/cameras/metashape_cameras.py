"""Reading cameras from the .xml that Agisoft Metashape exports (Export Cameras).

Its user manual (appendix Camera models) has local axes x right, y down, z forward, and (0.5, 0.5) for the centre of the
top-left pixel: this project's conventions. Lenses are its frame and fisheye models:

    x' = x (1 + K1 r^2 + K2 r^4 + K3 r^6 + K4 r^8) + (P1 (r^2 + 2 x^2) + 2 P2 x y) (1 + P3 r^2 + P4 r^4)
    y' = y (1 + K1 r^2 + K2 r^4 + K3 r^6 + K4 r^8) + (P2 (r^2 + 2 y^2) + 2 P1 x y) (1 + P3 r^2 + P4 r^4)
    u = w / 2 + cx + x' f + x' B1 + y' B2,    v = h / 2 + cy + y' f

with x = X / Z, y = Y / Z, of a fisheye times atan(r) / r. So P1 is OpenCV's p2 and P2 its p1, f + B1 is fx, and cx, cy
count from the middle of the image. The transform of a camera is chunk-from-camera, 4 x 4, row by row; that of its
component (of the chunk, in older files) goes on to the world: X_world = scale R X_chunk + T. Both as Agisoft's own
export to COLMAP (metashape-scripts, for Gaussian splatting) and nerfstudio (metashape_to_json) have them. Without such
a transform lengths are of no known unit.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from pipeline.base.errors import Complaints, InputError, listed
from pipeline.capture.cameras.camera_formats import (
    SourceImage,
    SourceLens,
    camera_from_lens,
    finite_numbers,
    resolve_owner,
)
from pipeline.capture.cameras.xml_documents import has_root, read_xml
from pipeline.geometry.cameras import Camera
from pipeline.geometry.lenses import BROWN_CONRADY, FISHEYE

MODELS = {"frame": BROWN_CONRADY, "fisheye": FISHEYE}

TERMS = {"k1": "k1", "k2": "k2", "k3": "k3", "k4": "k4", "p1": "p2", "p2": "p1", "p3": "P3", "p4": "P4", "b2": "B2"}
"""Metashape's terms by OpenCV's names, and those that OpenCV has none for by the manual's."""

EARTH = ("GEOGCS", "GEOCCS", "PROJCS", "GEOGCRS", "PROJCRS", "COMPD_CS", "COMPOUNDCRS")
"""Beginnings of reference systems in which a chunk's world has its origin at the Earth's centre."""

OFF = ("", "0", "false", "disabled", "none")

Similarity = tuple[float, np.ndarray, np.ndarray]
"""Scale, rotation, translation."""


def is_metashape(file: Path) -> bool:
    """Tell whether this is an exported .xml of cameras."""
    return file.suffix.lower() == ".xml" and has_root(file, "document")


def read_metashape(file: Path, cameras: Collection[str], complaints: Complaints) -> list[SourceImage]:
    """The aligned images that the capture's cameras took, by label. Other images may be anything.

    Raises:
        InputError: if the file is none, has several chunks, or lies on the Earth.
    """
    chunk = _chunk(read_xml(file))
    sensors = {sensor.get("id"): sensor for sensor in chunk.iterfind("sensors/sensor")}
    whole = _similarity(chunk)
    components = {part.get("id"): _similarity(part) for part in chunk.iterfind("components/component")}
    found, foreign = [], set()
    for entry in chunk.iterfind("cameras//camera"):
        label, owner, camera = entry.get("label", ""), None, None
        with complaints.collecting():
            owner = resolve_owner(label, cameras)
            if owner is not None and _is_used(entry):
                world = components.get(entry.get("component_id")) or whole
                camera = _camera(f"camera {label}", entry, sensors.get(entry.get("sensor_id")), world)
                foreign.add(entry.get("component_id") if world is None else "world")
        if owner is not None and _is_used(entry):
            found.append(SourceImage(owner, label, camera))
    if len(foreign) > 1:
        complaints.add("components", listed(sorted(map(str, foreign))), expected="one frame for all cameras",
                       found="components that nothing joins", hint="align or merge them first")  # fmt: skip
    return sorted(found, key=lambda image: image.name)


def _chunk(root: Element) -> Element:
    chunks = [chunk for chunk in root.iterfind("chunk") if chunk.get("enabled", "true").lower() not in OFF]
    if root.tag != "document" or len(chunks) != 1:
        found = listed([chunk.get("label") for chunk in chunks]) or "none"
        raise InputError(f"expected a document of Metashape with one chunk, found {found}; export one chunk alone")
    reference = (chunks[0].findtext("reference") or "").strip()
    if reference.upper().startswith(EARTH):
        hint = "choose Local Coordinates in the Reference pane and export again"
        raise InputError(f"reference: expected local coordinates, found {reference.split(',')[0]}; {hint}")
    return chunks[0]


def _is_used(entry: Element) -> bool:
    """Whether a camera has, or should have, a pose; those that were not aligned have none."""
    enabled = entry.get("enabled", "true").lower() not in OFF
    return enabled and (entry.find("transform") is not None or entry.get("master_id") is not None)


def _camera(where: str, entry: Element, sensor: Element | None, world: Similarity | None) -> Camera:
    try:
        if entry.find("transform") is None:
            hint = "export without the multi-camera system, each camera with its own transform"
            raise InputError(f"transform: expected its own, found one of camera {entry.get('master_id')}; {hint}")
        if sensor is None:
            raise InputError(f"sensor_id: expected a sensor of the file, found {entry.get('sensor_id', 'none')}")
        _refuse_rolling_shutter(entry, sensor)
        pose = _numbers(entry, "transform", (16,)).reshape(4, 4)
        scale, turn, shift = world or (1.0, np.eye(3), np.zeros(3))
        R = (turn @ pose[:3, :3]).T
        return camera_from_lens(R, -R @ (scale * turn @ pose[:3, 3] + shift), _lens(sensor))
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def _refuse_rolling_shutter(*elements: Element) -> None:
    """Refuse poses that change from row to row, however the version at hand writes them."""
    for element in elements:
        for part in element.iter():
            named = part.get("name", "") if part.tag == "property" else part.tag
            value = (part.get("value") or part.text or "").strip().lower()
            if "rolling_shutter" in named and value not in OFF:
                hint = "switch its compensation off, align again, and use a global shutter if the error grows"
                raise InputError(f"rolling shutter: expected one pose per image, found it compensated; {hint}")


def _lens(sensor: Element) -> SourceLens:
    kind = sensor.get("type", "frame")
    found = {c.get("class", "adjusted"): c for c in sensor.iterfind("calibration")}
    calibration = found.get("adjusted", found.get("initial"))
    if calibration is None:
        raise InputError(f"sensor {sensor.get('id')}: calibration: expected one, found none; align the images first")
    kind = calibration.get("type", kind)
    if kind not in MODELS:
        hint = "calibrate with one of those, or undistort the images"
        raise InputError(f"sensor {sensor.get('id')}: type: expected {' or '.join(MODELS)}, found {kind}; {hint}")
    size = calibration.find("resolution")
    size = sensor.find("resolution") if size is None else size
    width, height = (_whole(size, key) for key in ("width", "height"))
    values = {name: float(_numbers(calibration, name, ())) for name in ("f", "cx", "cy", "b1", *TERMS)
              if name == "f" or calibration.find(name) is not None}  # fmt: skip
    f = values["f"]
    terms = {"fx": f + values.get("b1", 0.0), "fy": f}
    terms |= {"cx": width / 2 + values.get("cx", 0.0), "cy": height / 2 + values.get("cy", 0.0)}
    terms |= {TERMS[name]: value for name, value in values.items() if name in TERMS}
    return SourceLens(MODELS[kind], terms, width, height)


def _similarity(owner: Element) -> Similarity | None:
    """World from chunk; None where there is none."""
    transform = owner.find("transform")
    if transform is None:
        return None
    if len(transform) == 0:  # one matrix, in older files
        matrix = _numbers(owner, "transform", (16,)).reshape(4, 4)
        scale, turn, shift = float(np.cbrt(np.linalg.det(matrix[:3, :3]))), matrix[:3, :3], matrix[:3, 3]
    else:
        scale = float(_numbers(transform, "scale", ())) if transform.find("scale") is not None else 1.0
        turn = scale * _numbers(transform, "rotation", (9,)).reshape(3, 3)
        shift = _numbers(transform, "translation", (3,))
    if scale <= 0:
        raise InputError(f"transform: expected a scale above 0, found {scale:g}")
    return scale, turn / scale, shift


def _numbers(owner: Element, name: str, shape: tuple[int, ...]) -> np.ndarray:
    """Numbers of a part, by its text."""
    words = (owner.findtext(name) or "").split()
    return finite_numbers({name: words if shape else words[0]} if words else {}, name, shape)


def _whole(size: Element | None, key: str) -> int:
    text = "none" if size is None else size.get(key, "none")
    if not text.isdecimal():
        raise InputError(f"resolution: {key}: expected a whole number of pixels, found {text}")
    return int(text)
