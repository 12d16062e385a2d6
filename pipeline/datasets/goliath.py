"""Goliath, heads, hands and bodies, read as its loader and its datasheet describe them.

Source: facebookresearch/goliath, `ca_code/utils/dataloader.py` and `DATASHEET.md`.
Images stay in one zip archive per camera. Of heads and hands, meshes, head poses and masks exist in fully lit frames
alone; the set's own loader leaves the others out, here they are interpolated. Bodies are always fully lit, by lights
that the set does not describe: they get avatars, which are not relit.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.errors import Complaints
from pipeline.capture.mask_format import MaskFormat
from pipeline.config.import_capture import ImportCapture
from pipeline.datasets.even_light import even_light
from pipeline.datasets.goliath_archives import find_archives, find_plates, image_size, image_table
from pipeline.datasets.goliath_beside import BESIDE, read_beside
from pipeline.datasets.goliath_cameras import DOWNSAMPLE, calibrated_names, read_goliath_cameras
from pipeline.datasets.goliath_frames import TEST_CAMERAS, frame_step, held_out, read_frames
from pipeline.datasets.goliath_kinds import GoliathKind, kind_of, shipped_fps
from pipeline.datasets.goliath_lights import read_goliath_lights
from pipeline.datasets.goliath_meshes import tracked_meshes
from pipeline.datasets.goliath_notes import say_given, say_masks
from pipeline.datasets.imported_capture import ImageStore, ImportedCapture, Provenance
from pipeline.datasets.kept_frames import frames_with_meshes, shown
from pipeline.datasets.layout import require
from pipeline.datasets.mask_agreement import posed_vertices, prove_meshes
from pipeline.datasets.set_masks import read_set_mask

BLACK_LEVEL = (2.0, 1.0, 2.0)
WHITE_BALANCE = (1.4, 1.1, 1.6)
"""Of heads and hands the set's loader subtracts the first from R, G and B, and multiplies by the second."""

SUBJECT_LABELS = (1, 2, 4, 5, 6, 7, 8, 9, 10)
"""Part labels that are the subject: hair, body, apparel, lenses, mouth; 0 is background and 3 the chair."""

FRAME_COLUMNS = ["frame", "timestamp_s", "segment"]


def read_goliath(root: Path, settings: ImportCapture) -> ImportedCapture:
    """A capture of a head, of a hand or of a body.

    Raises:
        InputError: naming all that is missing or wrong, or if the meshes do not project into the masks.
    """
    kind, complaints, provenance = kind_of(root), Complaints(root), Provenance()
    require(root, kind.files, complaints)
    complaints.raise_if_any()
    found = find_archives(root, settings.cameras, kind.masks)
    sizes = {name: image_size(root, name, min(frames)) for name, frames in found.images.items()}
    cameras = read_goliath_cameras(root / "camera_calibration.json", sizes, complaints)
    complaints.raise_if_any()
    lights = read_goliath_lights(root) if kind.lit else None
    listed_frames = read_frames(root, settings.segments, lights and lights.pattern_of, found, provenance)
    meshes, origin = tracked_meshes(root, listed_frames.frame.tolist(), kind.in_head, settings)
    frames, dropped = frames_with_meshes(listed_frames, meshes.table.frame.tolist(), str(root))
    if dropped:
        provenance.left_out["frames that lie between no two meshes"] = shown(dropped)
    images = image_table(found, frames.frame.tolist(), root, provenance, kind.masks)
    tracked = meshes.of_frames(frames.frame)
    plates = find_plates(root, {name: sizes[name] for name in cameras}, provenance)
    store = ImageStore(
        images, sizes, "linear", BLACK_LEVEL if kind.lit else 0.0, DOWNSAMPLE,
        mask_format(root, kind, images.mask_path.dropna()), clean_plates=plates,
    )  # fmt: skip
    proof = prove_meshes(root, store, cameras, tracked, settings.least_overlap)
    names = calibrated_names(root / "camera_calibration.json")
    if unseen := sorted(set(names) - set(found.images)):
        provenance.left_out["cameras without images"] = shown(unseen)
    say_given(provenance, kind, f"{origin}; {proof}", bool(plates))
    say_masks(provenance, images, kind.masks, "labels but background and chair" if kind.parts else "that is not 0")
    beside = read_beside(root, names, len(lights.places)) if lights else None
    fps, tested = shipped_fps(root) * frame_step(frames), TEST_CAMERAS
    if beside is not None:
        fps, tested = beside.fps, beside.test_cameras
        provenance.given["frames per second, test cameras, names of lights"] = f"{BESIDE}, of the export"
    numbers, first = frames.frame.tolist(), int(tracked.table.frame[0])
    if lights is None:
        placed, patterns = even_light(posed_vertices(root, tracked, first).mean(0), numbers)
    else:
        placed, patterns = lights.tables(numbers, provenance)
    if beside is not None:
        placed, patterns = beside.named(placed), beside.named(patterns)
    return ImportedCapture(
        kind.figure, fps, cameras, frames[["frame", "segment"]].assign(timestamp_s=frames.frame / fps)[FRAME_COLUMNS],
        store, placed, patterns, {name: np.diag(WHITE_BALANCE) for name in cameras} if kind.lit else {}, tracked,
        held_out(frames, list(cameras), tested), provenance, constant_light=not kind.lit,
    )  # fmt: skip


def mask_format(root: Path, kind: GoliathKind, masks: pd.Series) -> MaskFormat:
    """Format of the masks: numbers of parts, or values of the whole subject, 1 or 255."""
    if kind.parts:
        return MaskFormat(SUBJECT_LABELS, enlarged=True)
    ones = len(masks) > 0 and read_set_mask(root / masks.iloc[0]).max() == 1
    return MaskFormat((1,) if ones else None, enlarged=True)
