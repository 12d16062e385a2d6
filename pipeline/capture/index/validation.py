"""Validation of a capture folder: tables read, images decoded, all complaints at once."""

from __future__ import annotations

import tempfile
from collections.abc import Collection
from contextlib import nullcontext
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import pandas as pd

from pipeline.base.errors import Complaints
from pipeline.base.progress import progress
from pipeline.base.verdicts import Verdict
from pipeline.capture.index import calibration_files, tables
from pipeline.capture.index.calibration_sections import Contents, find_calibration
from pipeline.capture.index.contents import capture_content, image_source
from pipeline.capture.index.detected_files import NOTHING_DETECTED, DetectedFiles
from pipeline.capture.index.exchanged_images import Compared, complain_of_exchanged
from pipeline.capture.index.eye_tables import read_gaze_csv
from pipeline.capture.index.feature_views import feature_content
from pipeline.capture.index.frame_images import expected_images, find_frame_images
from pipeline.capture.index.held_out import check_splits, images_table
from pipeline.capture.index.image_checks import Known, gather, inspections, nothing_known
from pipeline.capture.index.keypoint_tables import KeypointSource, copy_keypoints, read_points_csv
from pipeline.capture.index.light_spectra import read_light_gains, with_gains
from pipeline.capture.index.mesh_tables import read_meshes
from pipeline.capture.index.tables import EXPOSURE_COLUMNS
from pipeline.capture.index.template_checks import check_template
from pipeline.capture.schema.capture_yaml import Capture, FeatureCameras, Images
from pipeline.capture.schema.manifest import MANIFEST, read_manifest

Tables = dict[str, pd.DataFrame | None]


@dataclass(frozen=True)
class CaptureIndex:
    """Tables and JSON contents of a valid capture, and verdicts on its images.

    By the names of the index's files.

    Attributes:
        keypoints: number of keypoints in the images; their tables are files, as memory does not hold them.
    """

    tables: dict[str, pd.DataFrame]
    contents: Contents
    verdicts: list[Verdict]
    keypoints: int


def index_folder(
    root: Path, threads: int = 4, known: Known = nothing_known, detected: DetectedFiles = NOTHING_DETECTED,
    folder: Path | None = None,
) -> CaptureIndex:  # fmt: skip
    """Validate a capture and index it. What is wrong in one place hides nothing that is wrong in another.

    Args:
        root: folder of the capture.
        threads: that decode images.
        known: inspections that were made before; all other images are inspected here.
        detected: keypoints and masks in place of the capture's own.
        folder: for the tables of keypoints, which memory does not hold; None: they are checked, and not kept.

    Raises:
        InputError: naming everything that is wrong, if anything is.
    """
    complaints = Complaints(root)
    manifest = read_manifest(root, complaints)
    found, known_keypoints = _read_tables(root, manifest, complaints)
    with tempfile.TemporaryDirectory(prefix="index_capture_") if folder is None else nullcontext(folder) as place:
        source = _keypoint_source(root, manifest, detected, known_keypoints.get("keypoint"), complaints)
        keypoints = copy_keypoints(source, known_keypoints, Path(place), complaints)
    contents, expected = find_calibration(root, manifest, found["cameras"], found["lights"], complaints)
    _check_transfer(manifest.images, complaints)
    images = find_frame_images(root, manifest, found["cameras"], found["frames"], complaints)
    images, mask_digests = detected.masked(images)
    own = images if detected.masks is None else images.assign(mask_path=None)
    total = len(expected) + int(own[["path", "mask_path"]].notna().to_numpy().sum())
    source, sizes = image_source(root, manifest, found["frames"], detected), found["cameras"]
    compared = None if source is None or sizes is None else Compared.among(images, sizes, source)
    inspected = inspections(root, chain(expected, expected_images(own, sizes, manifest, compared)), threads, known)
    digests, reduced = gather(progress(inspected, "images checked", total), complaints)
    digests |= mask_digests
    check_splits(manifest.splits, found["cameras"], found["frames"], complaints)
    complaints.raise_if_any()
    found["frames"] = found["frames"].drop(columns=list(EXPOSURE_COLUMNS), errors="ignore")
    verdicts = complain_of_exchanged(images, sizes, source, complaints, reduced)
    complaints.raise_if_any()
    contents = {name: calibration_files.with_digests(content, digests) for name, content in contents.items()}
    contents["capture"] = capture_content(root, manifest, found["eyes"], source)
    found |= {"images": images_table(images, digests, found["frames"], manifest.splits)}
    if isinstance(manifest.calibration.cameras, FeatureCameras):
        contents["calibration_cameras"] |= feature_content(
            found["images"], found["patterns"], len(found["lights"]), contents["capture"]["images"],
            contents["calibration_lights"],
        )  # fmt: skip
    return CaptureIndex(found, contents, verdicts, keypoints)


def _read_tables(
    root: Path, manifest: Capture, complaints: Complaints
) -> tuple[Tables, dict[str, Collection[object] | None]]:
    """All tables but those of images and keypoints; None for one that cannot be read.

    Beside them the values that frame, camera and keypoint of a table of keypoints may have.
    """
    found: Tables = dict.fromkeys(("cameras", "frames", "lights", "patterns"))
    if manifest.cameras:
        downsample = manifest.images.downsample_from_sensor if manifest.images else None
        found["cameras"] = tables.read_cameras_csv(root, manifest.cameras, downsample, complaints)
    if manifest.frames:
        found["frames"] = tables.read_frames_csv(root, manifest.frames, complaints)
        if found["frames"] is not None and manifest.fps:
            tables.check_rate(manifest.frames, found["frames"], manifest.fps, complaints)
    if manifest.lights:
        found["lights"] = tables.read_lights_csv(root, manifest.lights, complaints)
    if manifest.patterns:
        frames, lights = found["frames"], found["lights"]
        found["patterns"] = tables.read_patterns_csv(root, manifest.patterns, frames, lights, complaints)
    if manifest.spectra is not None and found["lights"] is not None:
        gains = read_light_gains(root, manifest.spectra, found["lights"], complaints)
        if gains is not None and found["patterns"] is not None and set(found["patterns"].light) <= set(gains.index):
            found["patterns"] = with_gains(found["patterns"], gains)
    keypoints = None
    if manifest.template:
        keypoints, found["eyes"], vertices = check_template(root, manifest.template, complaints)
        imported = manifest.imported is not None
        found["meshes"] = read_meshes(root, manifest.meshes, found["frames"], vertices, imported, complaints)
        if manifest.gaze and not manifest.template.eyes:
            expected = "a csv that says which vertices the eyes of gaze consist of"
            complaints.add(MANIFEST, "template.eyes", expected=expected, found="no such key")
        else:
            found["gaze"] = read_gaze_csv(root, manifest.gaze, found["frames"], found["eyes"], complaints)
    if manifest.template and manifest.keypoints_2d and not manifest.template.keypoints:
        expected = "a csv that says where the keypoints of keypoints_2d lie on the template"
        complaints.add(MANIFEST, "template.keypoints", expected=expected, found="no such key")
    known = {name: list(found[f"{name}s"][name]) for name in ("frame", "camera") if found[f"{name}s"] is not None}
    if keypoints is not None:
        known["keypoint"] = keypoints
    return found, known


def _keypoint_source(
    root: Path, manifest: Capture, detected: DetectedFiles, names: Collection[str] | None, complaints: Complaints
) -> KeypointSource:
    """The table of keypoints that is indexed.

    Args:
        names: keypoints of the template; None where that is in doubt.
    """
    if detected.keypoints is not None:
        return KeypointSource(detected.keypoints.parent, detected.keypoints.name, detected=True)
    given = manifest.template.points if manifest.template else None
    points = read_points_csv(root, given, names or [], complaints)
    return KeypointSource(root, manifest.keypoints_2d, manifest.keypoints_order, points, given)


def _check_transfer(images: Images | None, complaints: Complaints) -> None:
    if images is not None and images.transfer != "linear" and (images.path or "").lower().endswith(".exr"):
        complaints.add(
            MANIFEST, "images.transfer", expected="linear: OpenEXR files hold linear light by definition",
            found=images.transfer, hint="say linear, or convert the images to .png",
        )  # fmt: skip
