"""BecomingLit, read as its loader describes it.

Source: jonathsch/becominglit, `becominglit/data/bl_dataset.py` and `configs/default.yaml`. Meshes and masks are made by
the set's own preprocessing: meshes have to be there, masks may be.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.errors import Complaints, InputError
from pipeline.capture.archives import read_bytes
from pipeline.capture.images import decode_stored
from pipeline.capture.mask_format import PLAIN_MASKS, MaskFormat
from pipeline.config.import_capture import ImportCapture
from pipeline.datasets.becominglit_cameras import camera_names, read_colors, read_shared_lens
from pipeline.datasets.becominglit_landmarks import ORDER, landmark_files, read_landmarks
from pipeline.datasets.becominglit_sequences import (
    ALPHA,
    MESHES,
    NUMBERS_PER_SEQUENCE,
    PARTS,
    SequenceFiles,
    find_sequences,
    frames_of,
    image_table,
)
from pipeline.datasets.imported_capture import HeldOut, ImageStore, ImportedCapture, Provenance, TrackedMeshes
from pipeline.datasets.kept_frames import frames_with_meshes, shown
from pipeline.datasets.landmarks import placed_keypoints
from pipeline.datasets.layout import require
from pipeline.datasets.light_durations import intensities, lit_lights, read_durations, read_lights
from pipeline.datasets.mask_agreement import prove_meshes
from pipeline.datasets.up_axis import turned, upright_from_set
from pipeline.geometry.mesh_files import decode_mesh

log = logging.getLogger(__name__)

RELEASED = "it is part of the release: download it again"

FILES = {
    "calibration/camera_calibration.json": RELEASED,
    "calibration/color_calibration.json": RELEASED,
    "calibration/light_pattern_metadata.json": RELEASED,
    "sequences": RELEASED,
}
"""What has to be there, and where it comes from."""

FPS = 72.0
FULL_DURATION = 3000.0
"""Duration of intensity 1 in the set's loader."""

PARTIAL_GAIN = 1 / 0.66
"""Factor of the set's loader on intensities in frames that are not fully lit."""

SUBJECT_LABELS = (1, 2, *range(4, 20))
"""Part labels that are the subject: all but the background, 0, and clothes, 3, which the set's loader leaves out."""

TEST_CAMERA, TEST_SEQUENCE = "222200037", "FREE"
"""The split of the set's configuration."""

MAKES_MESHES = "it is made by the set's preprocessing, becominglit/data/preprocess/flame_tracker.py"
MAKES_MASKS = "becominglit/data/preprocess/birefnet.py and facer.py"


def read_becominglit(root: Path, settings: ImportCapture) -> ImportedCapture:
    """A capture of one subject, all its sequences.

    Raises:
        InputError: naming all that is missing or wrong, or if the meshes do not project into the masks.
    """
    complaints = Complaints(root)
    require(root, FILES, complaints)
    complaints.raise_if_any()
    pattern_file, provenance = root / "calibration/light_pattern_metadata.json", Provenance()
    lights = read_lights(pattern_file, 1.0)
    patterns = read_durations(pattern_file, "light_pattern", len(lights))
    names = camera_names(root, settings.cameras)
    folder = next((part for part in (PARTS, ALPHA) if any(root.glob(f"sequences/*/{part}"))), ALPHA)
    sequences = find_sequences(root, settings.segments, names, len(patterns), folder)
    names = [name for name in names if any(each.images[name] for each in sequences)]
    listed_frames = frames_of(sequences, provenance)
    meshes = mesh_table(sequences)
    if meshes.empty:
        raise InputError(f"{root}: sequences/*/{MESHES}: expected meshes, found none; {MAKES_MESHES}")
    frames, dropped = frames_with_meshes(listed_frames, meshes.frame.tolist(), str(root))
    if dropped:
        provenance.left_out["frames that lie between no two meshes"] = shown(dropped)
    sizes = {name: image_size(root, name, sequences) for name in names}
    cameras = read_shared_lens(root / "calibration/camera_calibration.json", sizes, complaints)
    colors = read_colors(root / "calibration/color_calibration.json", names, complaints)
    complaints.raise_if_any()
    upright = upright_from_set(cameras.values(), str(root))
    cameras = {name: turned(camera, upright) for name, camera in cameras.items()}
    lights[["x", "y", "z"]] = lights[["x", "y", "z"]].to_numpy() @ upright.T
    into_world = np.concatenate([upright, np.zeros((3, 1))], axis=1).ravel().tolist()
    kept = meshes[meshes.frame.isin(frames.frame)].reset_index(drop=True)
    rest = decode_mesh(read_bytes(root / kept.path[0]), root / kept.path[0])
    if not len(rest.faces):
        raise InputError(f"{root / kept.path[0]}: expected a mesh with faces, found vertices alone; {MAKES_MESHES}")
    tracked = TrackedMeshes(kept.assign(world_from_mesh=[into_world] * len(kept)), 1.0, rest, "fitted")
    masks = MaskFormat(SUBJECT_LABELS) if folder == PARTS else PLAIN_MASKS
    images = image_table(sequences, frames.frame.tolist(), provenance)
    store = ImageStore(images[images.camera.isin(names)].reset_index(drop=True), sizes, "srgb", 0.0, 1, masks)
    proof = prove_meshes(root, store, cameras, tracked, settings.least_overlap)
    say_given(provenance, sequences, folder, store.table, proof)
    keypoints = None
    if landmark_files(root, sequences, names):
        pieces = partial(read_landmarks, root, sequences, sizes, frames.frame.tolist())
        keypoints = placed_keypoints(root, pieces, ORDER, cameras, tracked, provenance)
    lit = lit_lights(patterns, len(lights), provenance)
    pattern_of = {each.first + frame: number for each in sequences for frame, number in each.pattern_of.items()}
    # As the set's loader does: durations are whole numbers.
    whole = [{light: float(int(duration)) for light, duration in pattern.items()} for pattern in patterns]
    return ImportedCapture(
        "head", FPS, cameras, frames.assign(timestamp_s=frames.frame / FPS)[["frame", "timestamp_s", "segment"]], store,
        lights[lights.light.isin(lit)].reset_index(drop=True),
        intensities(frames.frame.tolist(), pattern_of, whole, FULL_DURATION, PARTIAL_GAIN), colors, tracked,
        held_out(frames, names), provenance, keypoints=keypoints,
    )  # fmt: skip


def image_size(root: Path, camera: str, sequences: Sequence[SequenceFiles]) -> tuple[int, int]:
    """Width and height of a camera's first image, pixels."""
    each = next(each for each in sequences if each.images[camera])
    path = root / each.image_path(camera, min(each.images[camera]))
    height, width = decode_stored(read_bytes(path), path).shape[:2]
    return width, height


def mesh_table(sequences: Sequence[SequenceFiles]) -> pd.DataFrame:
    """frame and path of all meshes."""
    rows = [(each.first + frame, each.mesh_path(frame)) for each in sequences for frame in sorted(each.meshes)]
    return pd.DataFrame(rows, columns=["frame", "path"])


def held_out(frames: pd.DataFrame, cameras: Sequence[str]) -> HeldOut:
    """The set's split: one sequence and one camera."""
    tested = [camera for camera in cameras if camera == TEST_CAMERA]
    segments = [TEST_SEQUENCE] if TEST_SEQUENCE in set(frames.segment) else []
    if len(tested) == len(cameras) or frames.segment.nunique() == len(segments):
        raise InputError(
            "import_capture: expected cameras and sequences that train, found those of the test split alone"
        )
    if not tested:
        log.warning("camera %s of the set's split is not there: no camera is held out", TEST_CAMERA)
    if not segments:
        log.warning("sequence %s of the set's split is not there: no sequence is held out", TEST_SEQUENCE)
    return HeldOut(tested, [], segments)


def say_given(
    provenance: Provenance, sequences: Sequence[SequenceFiles], folder: str, images: pd.DataFrame, proof: str
) -> None:
    """Note what the set gave, and what is computed here."""
    masked = int(images.mask_path.notna().sum())
    if masked:
        kind = "all labels but background and clothes" if folder == PARTS else "shares, clothes included"
        provenance.given["masks"] = f"{folder} of {masked} images: {kind}"
    if masked < len(images):
        outlines = f"outlines of the meshes, for {len(images) - masked} of {len(images)} images"
        provenance.computed["masks"] = f"pack_shards: {outlines}; masks are made by {MAKES_MASKS}"
    numbers = ", ".join(f"{each.name} from {each.first}" for each in sequences)
    provenance.given.update(
        {
            "images": "sequences/*/images, 8-bit sRGB, in place",
            "frame numbers": f"those of each sequence, counted from a multiple of {NUMBERS_PER_SEQUENCE}: {numbers}",
            "cameras": "camera_calibration.json: one K counted from the image's corner, camera from world in metres, "
            "turned so that y is up",
            "lights": f"light_pattern_metadata.json, metres; intensity = duration / {FULL_DURATION:g}, divided by 0.66 "
            "in frames that are not fully lit",
            "colour": "color_calibration.json, 3 x 3 of linear light, then less 4 / 255",
            "meshes": f"{MESHES}, in the world; {proof}",
            "splits": f"sequence {TEST_SEQUENCE} and camera {TEST_CAMERA}, as the set's configuration has them",
        }
    )
    provenance.computed.update(
        {
            "motion of the head": "track_mesh: the rigid motion nearest to the meshes'",
            "meshes of partially lit frames": "track_mesh: where there are none, interpolated with the head's motion",
            "texture coordinates": "unwrap_atlas",
        }
    )
    provenance.left_out.update(
        {
            "flame_params, meshes_cano": "the posed meshes say the same",
            "sequences CALIB*, BACK*": "they have no subject",
        }
    )
