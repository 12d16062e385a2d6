"""Calibration images of a capture, checked to be enough to calibrate from.

Each function returns what the index says about its section, with the images still to be decoded (`ExpectedImage`):
their digests are filled in afterwards by `with_digests`.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any

import pandas as pd

from pipeline.base.errors import Complaints, listed
from pipeline.base.files import digest_file
from pipeline.capture.cameras.known_cameras import digest_known_cameras, read_known_cameras, read_known_lenses
from pipeline.capture.index.csv_tables import Kind, complain_repeats, complain_unknown, read_csv
from pipeline.capture.index.image_checks import ExpectedImage, IndexSection
from pipeline.capture.paths import find_files, locate
from pipeline.capture.schema.camera_schema import CameraFile, PhotographedBoards
from pipeline.capture.schema.capture_yaml import (
    EarlierLights,
    FeatureCameras,
    KnownCameras,
    KnownLights,
    MirrorBallLights,
)
from pipeline.capture.video_frames import VIDEO_SUFFIXES, count_frames
from pipeline.geometry.lenses import BROWN_CONRADY

CAMERAS = "the table of cameras"

TIME_COLUMNS: Mapping[str, Kind] = {"camera": "name", "view": "whole", "time_s": "number"}

FEWEST_LIGHTS = 3
"""Three points fix a rigid motion: fewer measured lights cannot place the cameras in the stage."""

FEWEST_SIGHTINGS = 2
"""One reflection gives a ray; a light's position needs two, from two ball positions or two cameras."""


def find_camera_calibration(
    root: Path, section: PhotographedBoards | KnownCameras | FeatureCameras, cameras: pd.DataFrame,
    complaints: Complaints,
) -> IndexSection:  # fmt: skip
    """`calibration_cameras.json`, and the board views, which must be of sensor size."""
    content: dict[str, Any] = section.model_dump(exclude_none=True)
    if isinstance(section, KnownCameras):
        with complaints.collecting():
            content["digest"] = digest_known_cameras(root, section)
            sizes = {row.camera: (int(row.sensor_width), int(row.sensor_height)) for row in cameras.itertuples()}
            read_known_cameras(root, section, sizes, complaints)
        return content, []
    if isinstance(section, FeatureCameras):
        content |= _given_lenses(root, section.lenses_from, BROWN_CONRADY.name, cameras, complaints)
        return content, []
    files = [{**values, "path": path} for path, values in find_files(root, section.path).items()]
    filmed = PurePosixPath(section.path).suffix.lower() in VIDEO_SUFFIXES
    if filmed:
        views = _frames(root, files, cameras, complaints)
    else:
        views = [{key: file[key] for key in ("camera", "view", "path")} for file in files]
    complain_unknown(complaints, section.path, "camera", [v["camera"] for v in views], list(cameras["camera"]), CAMERAS)
    if blind := [camera for camera in cameras["camera"] if camera not in {view["camera"] for view in views}]:
        found = f"none for {listed(blind)}"
        complaints.add(section.path, "camera", expected="at least one view of the board per camera", found=found)
    if section.times is not None:
        views = _with_times(root, section.times, views, complaints)
    content |= _given_lenses(root, section.lenses_from, section.lens, cameras, complaints)
    content["views"] = views
    return content, [] if filmed else _at_sensor_size(views, cameras)


def _given_lenses(
    root: Path, file: CameraFile | None, lens: str, cameras: pd.DataFrame, complaints: Complaints
) -> dict[str, str]:
    """Digest of a file of lenses, which has to be readable; nothing without one."""
    found: dict[str, str] = {}
    if file is not None:
        with complaints.collecting():
            found["lenses_digest"] = digest_known_cameras(root, file)
            sizes = {row.camera: (int(row.sensor_width), int(row.sensor_height)) for row in cameras.itertuples()}
            read_known_lenses(root, file, lens, sizes, complaints)
    return found


def _frames(root: Path, files: list[dict], cameras: pd.DataFrame, complaints: Complaints) -> list[dict]:
    """A view for each frame of each camera's video, which must be of sensor size."""
    sizes, views = {row.camera: (row.sensor_width, row.sensor_height) for row in cameras.itertuples()}, []
    for file in files:
        with complaints.collecting():
            path, camera = locate(root, file["path"]), file["camera"]
            count, size = count_frames(path)
            if size != sizes.get(camera, size):
                expected = "x".join(map(str, sizes[camera]))
                found = "x".join(map(str, size))
                complaints.add(file["path"], "size", expected=f"the sensor's {expected}", found=found)
            entry = {"camera": camera, "path": file["path"], "digest": digest_file(path)}
            views += [{**entry, "view": frame, "frame": frame} for frame in range(count)]
    return views


def _with_times(root: Path, path: str, views: list[dict], complaints: Complaints) -> list[dict]:
    """The views, each with its `time_s` of the table."""
    table = read_csv(root, path, TIME_COLUMNS, complaints)
    if table is None:
        return views
    complain_repeats(complaints, path, table, ["camera", "view"])
    times = {(row.camera, row.view): float(row.time_s) for row in table.itertuples()}
    if untimed := [view["path"] for view in views if (view["camera"], view["view"]) not in times]:
        complaints.add(path, "time_s", expected="a row for each image of a board", found=f"none for {listed(untimed)}")
    return [{**view, "time_s": times.get((view["camera"], view["view"]), 0.0)} for view in views]


def find_light_calibration(
    root: Path,
    section: MirrorBallLights | KnownLights | EarlierLights,
    cameras: pd.DataFrame,
    lights: pd.DataFrame,
    complaints: Complaints,
) -> IndexSection:
    """`calibration_lights.json`, and images of the mirror ball, which must be of sensor size."""
    if isinstance(section, KnownLights):
        return {"method": "known", "images": [], "silhouettes": []}, []
    if isinstance(section, EarlierLights):
        files = {"lights": section.lights, "cameras": section.cameras}
        digests = {}
        for name, path in files.items():
            with complaints.collecting():
                digests[f"{name}_digest"] = digest_file(locate(root, path))
        return {"method": "earlier", "images": [], "silhouettes": [], **files, **digests}, []
    dark = find_files(root, section.silhouette)
    silhouettes = [{"position": v["position"], "camera": v["camera"], "path": p} for p, v in dark.items()]
    # The pattern of the lit images matches the silhouettes too, as a light called 'silhouette'.
    lit = {path: values for path, values in find_files(root, section.path).items() if path not in dark}
    images = [{**{key: v[key] for key in ("position", "camera", "light")}, "path": p} for p, v in lit.items()]
    for path, entries in ((section.path, images), (section.silhouette, silhouettes)):
        complain_unknown(complaints, path, "camera", [e["camera"] for e in entries], list(cameras["camera"]), CAMERAS)
    seen = list(dict.fromkeys(image["light"] for image in images))
    complain_unknown(complaints, section.path, "light", seen, list(lights["light"]), "the table of lights")
    _check_sightings(section, images, silhouettes, len(seen), complaints)
    content = {"method": section.method, "radius_m": section.radius_m, "transfer": section.transfer}
    return {**content, "images": images, "silhouettes": silhouettes}, _at_sensor_size(images + silhouettes, cameras)


def _check_sightings(
    section: MirrorBallLights, images: list[dict], silhouettes: list[dict], lights: int, complaints: Complaints
) -> None:
    lit = {(entry["position"], entry["camera"]) for entry in images}
    with_silhouette = {(entry["position"], entry["camera"]) for entry in silhouettes}
    if not images:
        complaints.add(section.path, "calibration.lights.path", expected="images of the mirror ball", found="none")
        return
    if bare := sorted(lit - with_silhouette):
        found = f"none for {listed([' '.join(pair) for pair in bare])}"
        complaints.add(section.silhouette, "silhouette", expected="one per ball position and camera", found=found)
    if idle := sorted(with_silhouette - lit):
        found = f"none for {listed([' '.join(pair) for pair in idle])}"
        complaints.add(section.path, "images", expected="lit images for each silhouette", found=found)
    if len(lit) < FEWEST_SIGHTINGS:
        expected = f"at least {FEWEST_SIGHTINGS} pairs of ball position and camera"
        complaints.add(section.path, "position", expected=expected, found=f"{len(lit)}")
    if lights < FEWEST_LIGHTS:
        complaints.add(section.path, "light", expected=f"at least {FEWEST_LIGHTS} lights", found=f"{lights}")


def _at_sensor_size(entries: list[dict], cameras: pd.DataFrame) -> list[ExpectedImage]:
    sizes = {row.camera: (row.sensor_width, row.sensor_height) for row in cameras.itertuples()}
    return [
        ExpectedImage(entry["path"], "pattern", entry["camera"], sizes.get(entry["camera"]), "the sensor's size")
        for entry in entries
    ]


def with_digests(content: dict[str, Any], digests: dict[str, str]) -> dict[str, Any]:
    """The same content, each entry of its lists of images with the digest of the file it names."""

    def complete(entry: Any) -> Any:
        named = isinstance(entry, dict) and entry.get("path") in digests
        return {**entry, "digest": digests[entry["path"]]} if named else entry

    return {key: [complete(e) for e in value] if isinstance(value, list) else value for key, value in content.items()}
