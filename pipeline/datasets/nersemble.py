"""NeRSemble v2, heads that move under constant light, in one video per camera and sequence.

Source: tobias-kirschstein/nersemble-data, `data/nersemble_data.py`, `util/color_correction.py` and `constants.py`; the
splits are those of tobias-kirschstein/nersemble-benchmark, `constants.py`. Images stay in the videos. The set ships
neither meshes nor masks; its benchmark has videos of masks, which are taken where they are.
"""

from __future__ import annotations

import logging
from collections.abc import Collection, Sequence
from pathlib import Path

import pandas as pd

from pipeline.base.errors import Complaints, InputError
from pipeline.config.import_capture import ImportCapture
from pipeline.datasets.even_light import STANDS_FOR, even_light
from pipeline.datasets.imported_capture import HeldOut, ImageStore, ImportedCapture, Provenance
from pipeline.datasets.kept_frames import frames_with_meshes, shown
from pipeline.datasets.layout import require
from pipeline.datasets.mask_agreement import posed_vertices, prove_meshes
from pipeline.datasets.nersemble_cameras import (
    CALIBRATION,
    COLORS,
    camera_names,
    read_nersemble_cameras,
    read_nersemble_colors,
)
from pipeline.datasets.nersemble_sequences import (
    ALPHA,
    SequenceVideos,
    find_meshes,
    find_sequences,
    frame_rate,
    image_table,
)
from pipeline.datasets.up_axis import turned, upright_from_set

log = logging.getLogger(__name__)

FILES = {
    CALIBRATION: "it is part of the release: `nersemble-data download`",
    "sequences": "the release has a folder of videos per sequence there: `nersemble-data download`",
}
"""What has to be there, and where it comes from."""

TEST_CAMERAS = ("222200046", "222200037", "222200039")
"""Held out by the set's benchmark of new views: left, middle and right."""

TEST_SEQUENCES = ("FREE", "EMO-1-shout+laugh", "SEN-09-frown_events_bad", "SEN-10-port_strong_smokey")
"""Held out by the set's benchmark of avatars."""


def read_nersemble(root: Path, settings: ImportCapture) -> ImportedCapture:
    """The sequences of one participant.

    Raises:
        InputError: naming all that is missing or wrong, or if the meshes do not project into the masks.
    """
    complaints, provenance = Complaints(root), Provenance()
    require(root, FILES, complaints)
    complaints.raise_if_any()
    sequences = find_sequences(root, settings.segments, camera_names(root / CALIBRATION, settings.cameras))
    sizes = image_sizes(root, sequences)
    fps = frame_rate(sequences, root)
    written, said = read_nersemble_cameras(root / CALIBRATION, sizes, complaints)
    has_colors = (root / COLORS).is_file()
    colors = read_nersemble_colors(root / COLORS, sorted(sizes), complaints) if has_colors else {}
    complaints.raise_if_any()
    upright = upright_from_set(written.values(), str(root))
    cameras = {name: turned(camera, upright) for name, camera in written.items()}
    sequences, tracked = find_meshes(settings.mesh, sequences, upright, provenance)
    seen = {name for each in sequences for name in each.videos}
    cameras, colors = ({name: each[name] for name in each if name in seen} for each in (cameras, colors))
    every = [(each.first + number, each.name) for each in sequences for number in range(each.frames)]
    frames = pd.DataFrame(every, columns=["frame", "segment"])
    frames, dropped = frames_with_meshes(frames, tracked.table.frame.tolist(), str(root))
    if dropped:
        provenance.left_out["frames that lie between no two meshes"] = shown(dropped)
    images = image_table(sequences, frames.frame.tolist(), provenance)
    store = ImageStore(images, sizes, "srgb", 0.0, 1)
    proof = prove_meshes(root, store, cameras, tracked, settings.least_overlap)
    say_given(provenance, sequences, images, f"{said}; turned so that y is up", proof)
    say_colors(provenance, colors)
    middle = posed_vertices(root, tracked, int(tracked.table.frame[0])).mean(0)
    lights, patterns = even_light(middle, frames.frame.tolist())
    return ImportedCapture(
        "head", fps, cameras, frames.assign(timestamp_s=frames.frame / fps)[["frame", "timestamp_s", "segment"]], store,
        lights, patterns, colors, tracked, held_out(cameras, frames), provenance, constant_light=True,
    )  # fmt: skip


def image_sizes(root: Path, sequences: Sequence[SequenceVideos]) -> dict[str, tuple[int, int]]:
    """Width and height of each camera's images, by the headers of its videos.

    Raises:
        InputError: if those of a camera differ.
    """
    found: dict[str, set[tuple[int, int]]] = {}
    for each in sequences:
        for name, facts in each.videos.items():
            found.setdefault(name, set()).add((facts.width, facts.height))
    for name, sizes in found.items():
        if len(sizes) > 1:
            raise InputError(f"{root}: camera {name}: expected videos of one size, found {sorted(sizes)}")
    return {name: sizes.pop() for name, sizes in sorted(found.items())}


def held_out(cameras: Collection[str], frames: pd.DataFrame) -> HeldOut:
    """The split of the set's benchmarks: cameras of the one, sequences of the other."""
    tested = [name for name in TEST_CAMERAS if name in cameras]
    segments = [name for name in TEST_SEQUENCES if name in set(frames.segment)]
    if len(tested) == len(cameras):
        raise InputError("import_capture.cameras: expected cameras that train, found those of the benchmark alone")
    if len(segments) == frames.segment.nunique():
        log.warning("all sequences are of the benchmark's test: none is held out, but for cameras")
        segments = []
    if not tested:
        log.warning("no camera is of the benchmark's test: no camera is held out")
    return HeldOut(tested, segments=segments)


def say_given(
    provenance: Provenance, sequences: Sequence[SequenceVideos], images: pd.DataFrame, cameras: str, proof: str
) -> None:
    """Note what the set gave, and what is computed here."""
    numbers = ", ".join(f"{each.name} from {each.first}" for each in sequences)
    masked = int(images.mask_path.notna().sum())
    if masked:
        provenance.given["masks"] = f"{ALPHA} of {masked} images, the first channel of a video"
    if masked < len(images):
        outlines = f"pack_shards: outlines of the meshes, for {len(images) - masked} of {len(images)} images"
        provenance.computed["masks"] = f"{outlines}; the set's benchmark has masks, the set itself has none"
    provenance.given.update(
        {
            "images": "sequences/*/images/cam_*.mp4, frames of videos, 8-bit sRGB, in place",
            "frame numbers": f"those of each video, counted from a multiple of 100000: {numbers}",
            "times": "frames per second of the videos' headers",
            "cameras": f"{CALIBRATION}: camera from world, metres; K counted from the image's corner; {cameras}",
            "meshes": f"import_capture.mesh; {proof}",
            "splits": "cameras and sequences that the set's benchmarks hold out",
        }
    )
    provenance.computed.update(
        {
            "lights": f"{STANDS_FOR}; avatars are not relit",
            "motion of the head": "track_mesh: the rigid motion nearest to the meshes'",
            "meshes between given ones": "track_mesh: interpolated with the head's motion",
            "texture coordinates": "unwrap_atlas",
        }
    )
    provenance.assumed["light"] = STANDS_FOR
    provenance.assumed["where pixels count from"] = "the image's corner: the set's programs scale K without a shift"
    provenance.left_out["sequence BACKGROUND"] = "it has no subject"


def say_colors(provenance: Provenance, colors: dict) -> None:
    """Note the polynomials of colours, or that there are none."""
    if colors:
        terms = sorted({matrix.shape[1] for matrix in colors.values()})
        provenance.given["colour"] = f"{COLORS}: polynomials of linear light, {terms[0]} terms (Cheung et al. 2004)"
        return
    log.warning("%s is not there: colours stay as each camera recorded them", COLORS)
    provenance.left_out["colour"] = f"{COLORS} is not there: colours stay as each camera recorded them"
