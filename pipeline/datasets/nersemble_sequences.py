"""Sequences of NeRSemble: a video of each camera, and tracked meshes that lie elsewhere."""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float64

from pipeline.base.errors import InputError, listed
from pipeline.capture.archives import RED
from pipeline.capture.video_frames import VideoFacts, video_facts
from pipeline.datasets.imported_capture import Provenance, TrackedMeshes
from pipeline.datasets.meshes_beside import meshes_beside
from pipeline.geometry.mesh_files import Mesh

log = logging.getLogger(__name__)

EMPTY = "BACKGROUND"
"""The sequence without a subject: an image of each camera, no video."""

NUMBERS_PER_SEQUENCE = 100_000
"""Frames count from 0 in each sequence; here those of the kth count from k times this."""

ALPHA = "alpha_maps"
"""Folder of videos of masks, which the set's benchmark has beside its images."""

MAKES_MESHES = (
    "the set ships none: fit FLAME or another template to the videos (VHAP does), and write a mesh of each frame, in "
    "the world of camera_params.json, into a folder named after the sequence"
)


@dataclass(frozen=True)
class SequenceVideos:
    """One sequence.

    Attributes:
        name: as its folder is called, and here its segment.
        first: number that its frame 0 has here.
        videos: what the header of each camera's video says.
        masked: cameras with a video of masks, as long as that of images.
    """

    name: str
    first: int
    videos: Mapping[str, VideoFacts]
    masked: frozenset[str]

    @property
    def frames(self) -> int:
        """Frames that some camera has."""
        return max(facts.frames for facts in self.videos.values())


def find_sequences(root: Path, wanted: Collection[str], cameras: Collection[str]) -> list[SequenceVideos]:
    """All sequences with videos of these cameras, or the `wanted` ones, in order of their names.

    Raises:
        InputError: if one that is wanted is not there, or there is none.
    """
    every = sorted(path.name for path in (root / "sequences").iterdir() if path.is_dir())
    names = [name for name in every if name != EMPTY]
    if absent := sorted(set(wanted) - set(names)):
        raise InputError(f"import_capture.segments: expected some of {listed(names, 20)}, found {listed(absent)}")
    found = []
    for number, name in enumerate(names):
        if wanted and name not in wanted:
            continue
        folder = root / "sequences" / name
        there = [camera for camera in cameras if (folder / f"images/cam_{camera}.mp4").is_file()]
        videos = {camera: video_facts(folder / f"images/cam_{camera}.mp4") for camera in there}
        masks = {camera: folder / f"{ALPHA}/cam_{camera}.mp4" for camera in there}
        masked = {c for c, path in masks.items() if path.is_file() and video_facts(path).frames == videos[c].frames}
        if videos:
            found.append(SequenceVideos(name, number * NUMBERS_PER_SEQUENCE, videos, frozenset(masked)))
    if not found:
        raise InputError(f"{root}/sequences: expected videos */images/cam_*.mp4 of calibrated cameras, found none")
    return found


def frame_rate(sequences: Sequence[SequenceVideos], where: Path) -> float:
    """Frames per second that all videos say.

    Raises:
        InputError: if they differ.
    """
    rates = {round(facts.fps, 3) for each in sequences for facts in each.videos.values()}
    if len(rates) > 1:
        raise InputError(f"{where}: expected videos of one frame rate, found {listed(sorted(rates))} frames a second")
    return rates.pop()


def image_table(sequences: Sequence[SequenceVideos], frames: Collection[int], provenance: Provenance) -> pd.DataFrame:
    """camera, frame, path, mask_path of the frames' images; cameras that end early are named."""
    rows, kept, short = [], set(frames), {}
    for each in sequences:
        for camera, facts in each.videos.items():
            if facts.frames < each.frames:
                short[f"{each.name} {camera}"] = each.frames - facts.frames
            below, masked = f"sequences/{each.name}", camera in each.masked
            rows += [
                (camera, each.first + n, f"{below}/images/cam_{camera}.mp4/{n:06d}",
                 f"{below}/{ALPHA}/cam_{camera}.mp4/{n:06d}{RED}" if masked else None)
                for n in range(facts.frames) if each.first + n in kept
            ]  # fmt: skip
    if short:
        log.warning("cameras whose videos end before others: %s", short)
        provenance.left_out["images that are not there"] = listed([f"{n} of {name}" for name, n in short.items()])
    table = pd.DataFrame(rows, columns=["camera", "frame", "path", "mask_path"])
    return table.astype({"camera": "str", "frame": "int64", "path": "str", "mask_path": "str"})


def find_meshes(
    setting: str, sequences: Sequence[SequenceVideos], upright: Float64[np.ndarray, "3 3"], provenance: Provenance
) -> tuple[list[SequenceVideos], TrackedMeshes]:
    """Sequences with meshes, and these, which `import_capture.mesh` has.

    They lie in folders of the sequences' names; those of one sequence may also lie in the folder itself.

    Raises:
        InputError: if there are none.
    """
    place = Path(setting) if setting else None
    folders = {each.name: place / each.name for each in sequences} if place else {}
    if len(sequences) == 1 and not any(folder.is_dir() for folder in folders.values()):
        folders = {sequences[0].name: place}
    found = [each for each in sequences if folders.get(each.name) and folders[each.name].is_dir()]
    if lacking := [each.name for each in sequences if each not in found]:
        if not found:
            folder = f"a folder of meshes for each sequence, {place or 'MESHES'}/{lacking[0]}/000000.ply and so on"
            raise InputError(f"import_capture.mesh: expected {folder}, found {setting or 'none'}; {MAKES_MESHES}")
        log.warning("sequences without meshes; left out: %s", lacking)
        provenance.left_out["sequences without meshes"] = listed(lacking)
    tables, elsewhere, rest = [], {}, None
    for each in found:
        one = meshes_beside(str(folders[each.name]), range(each.frames), MAKES_MESHES)
        tables.append(one.table.assign(frame=one.table.frame + each.first, path=f"{each.name}/" + one.table.path))
        elsewhere |= {f"{each.name}/{name}": path for name, path in one.elsewhere.items()}
        rest = rest or one
    into_world = np.concatenate([upright, np.zeros((3, 1))], axis=1).ravel().tolist()
    table = pd.concat(tables, ignore_index=True)
    table = table.assign(world_from_mesh=[into_world] * len(table))
    shape = Mesh(rest.rest.vertices @ upright.T, rest.rest.faces)
    return found, replace(rest, table=table, rest=shape, motion="fitted", elsewhere=elsewhere)
