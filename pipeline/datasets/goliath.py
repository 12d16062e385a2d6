"""Goliath, captures of heads, read as its loader and its datasheet describe them.

Source: facebookresearch/goliath, `ca_code/utils/dataloader.py` and `DATASHEET.md`.
Images stay in one zip archive per camera. Meshes, head poses and part labels exist in fully lit frames alone; the
set's own loader leaves the others out, here they are interpolated.
"""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.errors import Complaints, InputError, listed
from pipeline.capture.mask_format import MaskFormat
from pipeline.config.import_capture import ImportCapture
from pipeline.datasets.goliath_archives import Archives, find_archives, image_size, image_table
from pipeline.datasets.goliath_beside import BESIDE, read_beside
from pipeline.datasets.goliath_cameras import DOWNSAMPLE, METRES_PER_UNIT, calibrated_names, read_goliath_cameras
from pipeline.datasets.goliath_meshes import find_meshes, read_rest
from pipeline.datasets.imported_capture import HeldOut, ImageStore, ImportedCapture, Provenance, TrackedMeshes
from pipeline.datasets.kept_frames import frames_with_meshes, shown
from pipeline.datasets.layout import csv_columns, require
from pipeline.datasets.light_durations import (
    intensities,
    lit_lights,
    read_durations,
    read_lights,
    read_pattern_of_frames,
)
from pipeline.datasets.mask_agreement import prove_meshes

log = logging.getLogger(__name__)

FILES = {
    "camera_calibration.json": "it is part of the release: download it again",
    "frame_splits_list.csv": "it is part of the release: download it again",
    "image": "the release has one archive of images per camera there",
    "lights/light_pattern_per_frame.json": "it is part of the release; captures of bodies have none: they are always "
    "fully lit, and teach no avatar how light changes",
    "lights/light_pattern_metadata.json": "it is part of the release: download it again",
    "kinematic_tracking/registration_vertices.zip": "it is part of the release: download it again",
    "head_pose/head_pose.zip": "it is part of the release: download it again",
}
"""What has to be there, and where it comes from."""

SHIPPED_FPS = 10.0
"""Of head captures, which were recorded at 30 and thinned out; numbers that go in steps count the recorded ones."""

FULL_DURATION = 5555.0
"""Duration of intensity 1 in the set's loader."""

BLACK_LEVEL = (2.0, 1.0, 2.0)
WHITE_BALANCE = (1.4, 1.1, 1.6)
"""The set's loader subtracts the first from R, G and B, and multiplies by the second."""

SUBJECT_LABELS = (1, 2, 4, 5, 6, 7, 8, 9, 10)
"""Part labels that are the subject: hair, body, apparel, lenses, mouth; 0 is background and 3 the chair."""

TEST_CAMERAS = ("401645", "401964", "402501", "402597", "402801", "402871", "402873", "402956", "402969", "402978",
                "402982", "403066")  # fmt: skip
"""Cameras of the example split of the set's loader."""

ALL_SEGMENTS = "all"

FRAME_COLUMNS = ["frame", "timestamp_s", "segment"]


def read_goliath(root: Path, settings: ImportCapture) -> ImportedCapture:
    """A capture of a head.

    Raises:
        InputError: naming all that is missing or wrong, or if the meshes do not project into the masks.
    """
    if "Head" not in root.name:
        raise InputError(
            f"{root}: expected the capture of a head, whose folder's name has 'Head', as the set says of what it is; "
            f"found {root.name!r}; hands and bodies are not read yet"
        )
    complaints = Complaints(root)
    require(root, FILES, complaints)
    complaints.raise_if_any()
    found = find_archives(root, settings.cameras)
    sizes = {name: image_size(root, name, min(frames)) for name, frames in found.images.items()}
    cameras = read_goliath_cameras(root / "camera_calibration.json", sizes, complaints)
    complaints.raise_if_any()
    pattern_file = root / "lights/light_pattern_metadata.json"
    lights = read_lights(pattern_file, METRES_PER_UNIT)
    patterns = read_durations(pattern_file, "light_patterns", len(lights))
    pattern_of = read_pattern_of_frames(root / "lights/light_pattern_per_frame.json", len(patterns))
    provenance = Provenance()
    listed_frames = read_frames(root, settings.segments, pattern_of, found, provenance)
    meshes = find_meshes(root, listed_frames.frame.tolist())
    frames, dropped = frames_with_meshes(listed_frames, meshes.frame.tolist(), str(root))
    if dropped:
        provenance.left_out["frames that lie between no two meshes"] = shown(dropped)
    rest, origin = read_rest(root, settings.topology)
    images = image_table(found, frames.frame.tolist(), root, provenance)
    tracked = TrackedMeshes(meshes[meshes.frame.isin(frames.frame)].reset_index(drop=True), METRES_PER_UNIT, rest)
    store = ImageStore(images, sizes, "linear", BLACK_LEVEL, DOWNSAMPLE, MaskFormat(SUBJECT_LABELS, enlarged=True))
    lit = lit_lights(patterns, len(lights), provenance)
    beside = read_beside(root, calibrated_names(root / "camera_calibration.json"), len(lights))
    fps = SHIPPED_FPS * frame_step(frames) if beside is None else beside.fps
    say_given(provenance, origin, prove_meshes(root, store, cameras, tracked, settings.least_overlap))
    say_masks(provenance, images)
    if unseen := sorted(set(calibrated_names(root / "camera_calibration.json")) - set(found.images)):
        provenance.left_out["cameras without images"] = shown(unseen)
    # As the set's loader does: durations are whole numbers.
    whole = [{light: float(int(duration)) for light, duration in pattern.items()} for pattern in patterns]
    placed = lights[lights.light.isin(lit)].reset_index(drop=True)
    shown_lights = intensities(frames.frame.tolist(), pattern_of, whole, FULL_DURATION)
    if beside is not None:
        placed, shown_lights = beside.named(placed), beside.named(shown_lights)
        provenance.given["frames per second, test cameras, names of lights"] = f"{BESIDE}, of the export"
    tested = TEST_CAMERAS if beside is None else beside.test_cameras
    return ImportedCapture(
        "head", fps, cameras, frames[["frame", "segment"]].assign(timestamp_s=frames.frame / fps)[FRAME_COLUMNS],
        store, placed, shown_lights, {name: np.diag(WHITE_BALANCE) for name in cameras}, tracked,
        held_out(frames, list(cameras), tested), provenance,
    )  # fmt: skip


def read_frames(
    root: Path, wanted: Collection[str], pattern_of: Mapping[int, int], found: Archives, provenance: Provenance
) -> pd.DataFrame:
    """Frames whose light and images are there, in order; the others are named.

    Columns are frame, split and segment.

    Raises:
        InputError: if no frame is left, or a wanted segment is not there.
    """
    frames = csv_columns(root / "frame_splits_list.csv", ("frame", "split")).drop_duplicates().sort_values("frame")
    if (root / "frame_segments_list.csv").is_file():
        segments = csv_columns(root / "frame_segments_list.csv", ("segment_name", "frame")).drop_duplicates("frame")
        frames["segment"] = frames.frame.map(segments.set_index("frame").segment_name).fillna(ALL_SEGMENTS).astype(str)
    else:
        frames["segment"] = ALL_SEGMENTS
    if absent := sorted(set(wanted) - set(frames.segment)):
        known = listed(list(dict.fromkeys(frames.segment)), 20)
        raise InputError(f"import_capture.segments: expected some of {known}, found {listed(absent)}")
    if wanted:
        frames = frames[frames.segment.isin(list(wanted))]
    seen = frozenset().union(*found.images.values())
    for why, missing in (
        ("frames without a light pattern", ~frames.frame.isin(list(pattern_of))),
        ("frames without images", ~frames.frame.isin(list(seen))),
    ):
        if missing.any():
            numbers = frames.frame[missing].tolist()
            log.warning("%d %s; left out: %s", len(numbers), why, numbers)
            provenance.left_out[why] = shown(numbers)
            frames = frames[~missing]
    if frames.empty:
        raise InputError(f"{root}: expected frames with a split, a light pattern and images, found none")
    return frames.reset_index(drop=True)


def frame_step(frames: pd.DataFrame) -> int:
    """The usual distance of frame numbers within a segment."""
    steps = frames.groupby("segment").frame.diff().dropna()
    return int(steps.mode().iloc[0]) if len(steps) else 1


def held_out(frames: pd.DataFrame, cameras: Collection[str], test_cameras: Collection[str]) -> HeldOut:
    """The set's split.

    Segments that are for testing as a whole, single frames of others, and the cameras that test.
    """
    test = frames.split == "test"
    whole = test.groupby(frames.segment).all()
    segments = whole.index[whole].tolist()
    tested = [camera for camera in cameras if camera in test_cameras]
    if len(tested) in (0, len(cameras)) and test_cameras:
        log.warning("none of the cameras, or all, are of the set's example split: no camera is held out")
        tested = []
    return HeldOut(tested, frames.frame[test & ~frames.segment.isin(segments)].tolist(), segments)


def say_masks(provenance: Provenance, images: pd.DataFrame) -> None:
    """Note how many images have part labels; the others get the mesh's outline."""
    masked = int(images.mask_path.notna().sum())
    if masked:
        provenance.given["masks"] = f"segmentation_parts of {masked} images, all labels but background and chair"
    if masked < len(images):
        outlines = f"pack_shards: outlines of the meshes, for {len(images) - masked} of {len(images)} images"
        provenance.computed["masks of images without part labels"] = outlines


def say_given(provenance: Provenance, rest: str, proof: str) -> None:
    """Note what the set gave, and what is computed here."""
    provenance.given.update(
        {
            "images": "image/cam*.zip, 8-bit linear AVIF, in place; black level 2, 1, 2 of R, G, B",
            "cameras": "camera_calibration.json: K.T counted from pixel centres (half a pixel added), T.T camera from "
            "world in mm, distortion k1 k2 p1 p2",
            "lights": f"lights/light_pattern_metadata.json, mm; intensity = duration / {FULL_DURATION:g}",
            "light patterns": "lights/light_pattern_per_frame.json",
            "colour": "white balance 1.4, 1.1, 1.6 of R, G, B, the same for all cameras",
            "meshes": f"registration_vertices in the frame of the head, moved by head_pose; {rest}; {proof}",
            "splits": "frame_splits_list.csv; the example cameras of the set's loader",
        }
    )
    provenance.computed.update(
        {
            "meshes of partially lit frames": "track_mesh: interpolated in the frame of the head, which turns by slerp",
            "texture coordinates": "unwrap_atlas",
            "mean textures": "bake_textures; the set's own uv_image is not read",
        }
    )
    provenance.left_out.update(
        {
            "keypoints_3d, scan_mesh, uv_image": "nothing here needs them",
            "per_view_background": "what is not the subject is masked",
        }
    )
