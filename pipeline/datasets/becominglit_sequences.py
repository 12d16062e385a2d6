"""Sequences of BecomingLit: what each holds of images, masks, meshes and light patterns."""

from __future__ import annotations

import logging
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from pipeline.base.errors import InputError, listed
from pipeline.datasets.imported_capture import Provenance
from pipeline.datasets.kept_frames import shown
from pipeline.datasets.light_durations import read_pattern_of_frames

log = logging.getLogger(__name__)

SKIPPED = ("CALIB", "BACK")
"""Beginnings of the names of sequences without a subject."""

NUMBERS_PER_SEQUENCE = 100_000
"""Frames count from 0 in each sequence; here those of the kth count from k times this, 23 minutes at 72 fps."""

PARTS, ALPHA = "facer_segmentation", "alpha_birefnet"
"""Folders of masks, part labels or shares; both are made by the set's own preprocessing."""

MESHES = "flame_tracking/meshes_posed"


@dataclass(frozen=True)
class SequenceFiles:
    """One sequence.

    Attributes:
        name: as its folder is called, and here its segment.
        first: number that its frame 0 has here.
        pattern_of: number of the light pattern by frame, in the numbers of the sequence.
        images: frames with an image, by camera; suffix of the images' files.
        masks: frames with a mask, by camera.
        mask_folder: `PARTS` or `ALPHA`.
        meshes: frames with a mesh.
    """

    name: str
    first: int
    pattern_of: Mapping[int, int]
    images: Mapping[str, frozenset[int]]
    suffix: str
    masks: Mapping[str, frozenset[int]]
    mask_folder: str
    meshes: frozenset[int]

    def image_path(self, camera: str, frame: int) -> str:
        """An image, below the set's folder."""
        return f"sequences/{self.name}/images/cam_{camera}/frame_{frame:06d}{self.suffix}"

    def mask_path(self, camera: str, frame: int) -> str:
        """A mask, below the set's folder."""
        suffix = ".png" if self.mask_folder == PARTS else ".jpg"
        return f"sequences/{self.name}/{self.mask_folder}/cam_{camera}/frame_{frame:06d}{suffix}"

    def mesh_path(self, frame: int) -> str:
        """A mesh in the world, below the set's folder."""
        return f"sequences/{self.name}/{MESHES}/frame_{frame:06d}.ply"


def find_sequences(
    root: Path, wanted: Collection[str], cameras: Collection[str], patterns: int, mask_folder: str
) -> list[SequenceFiles]:
    """All sequences with a subject, or the `wanted` ones, in the order of their names.

    Raises:
        InputError: if one that is wanted is not there, or there is none.
    """
    every = sorted(path.name for path in (root / "sequences").iterdir() if path.is_dir())
    names = [name for name in every if not name.startswith(SKIPPED)]
    if absent := sorted(set(wanted) - set(names)):
        raise InputError(f"import_capture.segments: expected some of {listed(names, 20)}, found {listed(absent)}")
    found = []
    for number, name in enumerate(names):
        if wanted and name not in wanted:
            continue
        folder = root / "sequences" / name
        pattern_of = read_pattern_of_frames(folder / "light_pattern_per_frame.json", patterns)
        suffix = next((path.suffix for path in sorted((folder / "images").glob("cam_*/frame_*"))), ".avif")
        images = {camera: _frames_in(folder / f"images/cam_{camera}") for camera in cameras}
        masks = {camera: _frames_in(folder / f"{mask_folder}/cam_{camera}") for camera in cameras}
        first = number * NUMBERS_PER_SEQUENCE
        meshes = _frames_in(folder / MESHES)
        found.append(SequenceFiles(name, first, pattern_of, images, suffix, masks, mask_folder, meshes))
    if not found:
        raise InputError(f"{root}/sequences: expected folders of sequences, found {listed(every) or 'none'}")
    return found


def _frames_in(folder: Path) -> frozenset[int]:
    matches = (re.fullmatch(r"frame_(\d{6})\.\w+", path.name) for path in folder.glob("frame_*"))
    return frozenset(int(match[1]) for match in matches if match)


def frames_of(sequences: Sequence[SequenceFiles], provenance: Provenance) -> pd.DataFrame:
    """frame, segment of the frames with a light pattern and images, in this project's numbers."""
    rows, lacking = [], []
    for each in sequences:
        seen = frozenset().union(*each.images.values())
        rows += [(each.first + frame, each.name) for frame in sorted(set(each.pattern_of) & seen)]
        lacking += [f"{each.name} {frame}" for frame in sorted(set(each.pattern_of) ^ seen)]
    if lacking:
        log.warning("%d frames without a light pattern, or without images; left out: %s", len(lacking), lacking)
        provenance.left_out["frames without light pattern or images"] = shown(lacking)
    return pd.DataFrame(rows, columns=["frame", "segment"])


def image_table(sequences: Sequence[SequenceFiles], frames: Collection[int], provenance: Provenance) -> pd.DataFrame:
    """camera, frame, path, mask_path of the frames' images; what is lacking is named."""
    rows, lacking, kept = [], {}, set(frames)
    for each in sequences:
        own = [frame for frame in sorted(each.pattern_of) if each.first + frame in kept]
        for camera, there in each.images.items():
            masks = each.masks[camera]
            rows += [
                (camera, each.first + f, each.image_path(camera, f), each.mask_path(camera, f) if f in masks else None)
                for f in own if f in there
            ]  # fmt: skip
            if absent := sum(frame not in there for frame in own):
                lacking[f"{each.name} {camera}"] = absent
    if lacking:
        log.warning("cameras without some images: %s", lacking)
        provenance.left_out["images that are not there"] = listed([f"{n} of {name}" for name, n in lacking.items()])
    table = pd.DataFrame(rows, columns=["camera", "frame", "path", "mask_path"])
    return table.astype({"camera": "str", "frame": "int64", "path": "str", "mask_path": "str"})
