"""ava-256, captures of heads under constant light, in archives like Goliath's.

Source: facebookresearch/ava-256, `data/ava_dataset.py` and `DATASHEET.md`. Every frame has a mesh and a head pose.
Light comes from all sides and never changes, so that heads are tracked and get avatars, which are not relit.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.errors import Complaints, InputError, listed
from pipeline.capture.mask_format import MaskFormat
from pipeline.config.import_capture import ImportCapture
from pipeline.datasets.even_light import STANDS_FOR, even_light
from pipeline.datasets.goliath import SUBJECT_LABELS
from pipeline.datasets.goliath_archives import PARTS, Archives, find_archives, image_size, image_table
from pipeline.datasets.goliath_cameras import METRES_PER_UNIT, calibrated_names, read_goliath_cameras
from pipeline.datasets.goliath_meshes import find_meshes, read_rest
from pipeline.datasets.goliath_notes import say_masks
from pipeline.datasets.imported_capture import HeldOut, ImageStore, ImportedCapture, Provenance, TrackedMeshes
from pipeline.datasets.kept_frames import frames_with_meshes, shown
from pipeline.datasets.layout import csv_columns, json_key, require
from pipeline.datasets.mask_agreement import posed_vertices, prove_meshes

log = logging.getLogger(__name__)

RELEASED = "it is part of the release: download it again"

CALIBRATION, FRAME_LIST = "camera_calibration.json", "frame_list.csv"

FILES = {
    CALIBRATION: RELEASED,
    FRAME_LIST: RELEASED,
    "image": "the release has one archive of images per camera there",
    "kinematic_tracking/registration_vertices.zip": RELEASED,
    "head_pose/head_pose.zip": RELEASED,
}
"""What has to be there, and where it comes from."""

DECODER = "decoder"
"""Folder of the dome's capture; that of the headset is beside it."""

FPS = 30.0
"""At which frame numbers count."""

DOWNSAMPLES = (2, 4)
"""Sensor pixels along a side of an image's pixel, of the two releases: 1334 x 2048 and 667 x 1024 of 2668 x 4096."""

TEST_SEGMENT = "EXP_free_face"
"""Recommended by the datasheet to be withheld."""


def read_ava256(root: Path, settings: ImportCapture) -> ImportedCapture:
    """The dome's capture of one person.

    Raises:
        InputError: naming all that is missing or wrong, or if the meshes do not project into the masks.
    """
    inside = root if (root / CALIBRATION).is_file() else root / DECODER
    complaints = Complaints(inside)
    require(inside, FILES, complaints)
    complaints.raise_if_any()
    found, provenance = find_archives(inside, settings.cameras), Provenance()
    sizes = {name: image_size(inside, name, min(frames)) for name, frames in found.images.items()}
    downsample, resolution = choose_downsample(inside / CALIBRATION, sizes)
    cameras = read_goliath_cameras(inside / CALIBRATION, sizes, complaints, downsample)
    complaints.raise_if_any()
    listed_frames = read_frames(inside, settings, found, provenance)
    meshes = find_meshes(inside, listed_frames.frame.tolist(), folder="")
    frames, dropped = frames_with_meshes(listed_frames, meshes.frame.tolist(), str(inside))
    if dropped:
        provenance.left_out["frames that lie between no two meshes"] = shown(dropped)
    rest, origin = read_rest(inside, settings.topology)
    below = "" if inside == root else f"{DECODER}/"
    images = image_table(found, frames.frame.tolist(), inside, provenance)
    images = images.assign(path=below + images["path"], mask_path=below + images["mask_path"])
    table = meshes[meshes.frame.isin(frames.frame)].reset_index(drop=True)
    tracked = TrackedMeshes(table.assign(path=below + table["path"]), METRES_PER_UNIT, rest)
    store = ImageStore(images, sizes, "srgb", 0.0, downsample, MaskFormat(SUBJECT_LABELS, enlarged=True))
    proof = prove_meshes(root, store, cameras, tracked, settings.least_overlap)
    if unseen := sorted(set(calibrated_names(inside / CALIBRATION)) - set(found.images)):
        provenance.left_out["cameras without images"] = shown(unseen)
    say_given(provenance, f"{origin}; {proof}", resolution)
    say_masks(provenance, images, PARTS, "labels but background and chair")
    middle = posed_vertices(root, tracked, int(table.frame[0])).mean(0)
    lights, patterns = even_light(middle, frames.frame.tolist())
    return ImportedCapture(
        "head", FPS, cameras, frames.assign(timestamp_s=frames.frame / FPS)[["frame", "timestamp_s", "segment"]], store,
        lights, patterns, {}, tracked, held_out(frames), provenance, constant_light=True,
    )  # fmt: skip


def choose_downsample(path: Path, sizes: Mapping[str, tuple[int, int]]) -> tuple[int, str]:
    """Factor by which images are smaller than the sensor, whose K the file has, and why.

    It is the one that puts principal points nearest to the middle.
    """
    entries = {str(entry.get("cameraId")): entry for entry in json_key(path, "KRT")}
    points = {}
    for name in set(sizes) & set(entries):
        try:
            points[name] = np.asarray(entries[name].get("K"), np.float64)[2, :2]
        except (TypeError, ValueError, IndexError):  # Complained of where cameras are read.
            continue
    away = {factor: off_middle(points, sizes, factor) for factor in DOWNSAMPLES}
    said = ", ".join(f"{value:.3f} of its side if {factor}" for factor, value in away.items())
    log.info("%s: principal points are off the sensor's middle by %s times the images' size", path, said)
    best = min(away, key=lambda factor: away[factor])
    return best, f"images are {best} times smaller than the sensor: principal points are off its middle by {said}"


def off_middle(points: Mapping[str, np.ndarray], sizes: Mapping[str, tuple[int, int]], factor: int) -> float:
    """Mean distance of principal points from the sensor's middle, over its sides."""
    shares = [np.abs(point / (factor * np.array(sizes[name])) - 0.5).mean() for name, point in points.items()]
    return float(np.mean(shares)) if shares else np.inf


def read_frames(root: Path, settings: ImportCapture, found: Archives, provenance: Provenance) -> pd.DataFrame:
    """frame, segment of the frames that have images, in order; the others are named.

    Raises:
        InputError: if no frame is left, or a wanted segment is not there.
    """
    table = csv_columns(root / FRAME_LIST, ("seg_id", "frame_id")).drop_duplicates("frame_id")
    frames = pd.DataFrame({"frame": table.frame_id.astype("int64"), "segment": table.seg_id.astype(str)})
    if absent := sorted(set(settings.segments) - set(frames.segment)):
        known = listed(list(dict.fromkeys(frames.segment)), 20)
        raise InputError(f"import_capture.segments: expected some of {known}, found {listed(absent)}")
    if settings.segments:
        frames = frames[frames.segment.isin(settings.segments)]
    seen = frozenset().union(*found.images.values())
    if unseen := sorted(set(frames.frame) - seen):
        log.warning("%d frames of %s have no images; left out: %s", len(unseen), FRAME_LIST, unseen)
        provenance.left_out["frames without images"] = shown(unseen)
        frames = frames[~frames.frame.isin(unseen)]
    if frames.empty:
        raise InputError(f"{root / FRAME_LIST}: expected frames with images, found none")
    return frames.sort_values("frame").reset_index(drop=True)


def held_out(frames: pd.DataFrame) -> HeldOut:
    """The datasheet's split: one segment."""
    if set(frames.segment) == {TEST_SEGMENT}:
        raise InputError(f"import_capture.segments: expected segments that train, found {TEST_SEGMENT} alone")
    if TEST_SEGMENT not in set(frames.segment):
        log.warning("segment %s of the set's split is not there: no segment is held out", TEST_SEGMENT)
        return HeldOut()
    return HeldOut(segments=[TEST_SEGMENT])


def say_given(provenance: Provenance, meshes: str, resolution: str) -> None:
    """Note what the set gave, and what is computed here."""
    provenance.given.update(
        {
            "images": "image/cam*.zip, 8-bit AVIF, in place; the set does not say how they store light: sRGB, as its "
            "programs show them",
            "cameras": f"{CALIBRATION}: K.T counted from pixel centres (half a pixel added), T.T camera from world in "
            f"mm, distortion k1 k2 p1 p2; {resolution}",
            "meshes": f"registration_vertices in the frame of the head, moved by head_pose; {meshes}",
            "splits": f"segment {TEST_SEGMENT} tests, as the datasheet recommends",
        }
    )
    provenance.computed.update(
        {"lights": f"{STANDS_FOR}; avatars are not relit", "texture coordinates": "unwrap_atlas", "mean textures":
         "bake_textures"}
    )  # fmt: skip
    provenance.assumed["how images store light"] = "sRGB, as the set's programs show them, which do not say it"
    provenance.assumed["light"] = STANDS_FOR
    provenance.left_out.update(
        {
            "keypoints_3d": "points in space, of no image; nothing says which each is, and all frames have meshes",
            "uv_image": "textures are baked anew",
            "the headset's images": "of parts of the face, by other cameras",
        }
    )
