"""ActorsHQ, a moving actor under constant light.

Source: synthesiaresearch/humanrf, `actorshq/dataset/camera_data.py`, `actorshq/dataset/volumetric_dataset.py` and
`actorshq/evaluation/presets.py`. Its meshes are reconstructed anew in each frame, as an Alembic file, so that no vertex
is the same in two: tracked meshes of one topology are to be given.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.errors import Complaints, InputError, listed
from pipeline.capture.archives import read_bytes
from pipeline.capture.images import decode_stored
from pipeline.capture.mask_format import PLAIN_MASKS, MaskFormat
from pipeline.config.import_capture import ImportCapture
from pipeline.datasets.actorshq_cameras import CALIBRATION, read_actorshq_cameras
from pipeline.datasets.even_light import STANDS_FOR, even_light
from pipeline.datasets.imported_capture import HeldOut, ImageStore, ImportedCapture, Provenance
from pipeline.datasets.kept_frames import frames_with_meshes, shown
from pipeline.datasets.layout import require
from pipeline.datasets.mask_agreement import posed_vertices, prove_meshes
from pipeline.datasets.meshes_beside import meshes_beside
from pipeline.datasets.set_masks import read_set_mask
from pipeline.datasets.up_axis import turned, upright_from_set
from pipeline.geometry.mesh_files import Mesh

log = logging.getLogger(__name__)

FILES = {
    CALIBRATION: "it is part of each scale of the release: name the folder of one, such as Actor01/Sequence1/4x",
    "rgbs": "the release has a folder of images per camera there",
    "masks": "the release has a folder of masks per camera there",
}
"""What has to be there, and where it comes from."""

FPS = 25.0
"""Taken for the set's rate; only time stamps depend on it."""

SEGMENT = "sequence"

TEST_INDICES = (0, 13, 24, 30, 43, 57, 63, 64, 70, 84, 97, 103, 114, 126)
VALIDATION_INDICES = (10, 19, 33, 44, 50, 73, 83, 90, 104, 117)
UNUSED_INDICES = (128, 129, 136, 137, 144, 145, 146, 147, 152, 153, 154, 155)
"""Cameras of the authors' split, counted from 0, while their names count from 1; the last ones are in no part of it."""

MAKES_MESHES = (
    "the set's meshes.abc has other vertices in each frame; fit a template to its frames, or SMPL-X to the images, and "
    "write one mesh per frame, in the world of calibration.csv"
)


def read_actorshq(root: Path, settings: ImportCapture) -> ImportedCapture:
    """One sequence of one actor, at one of its scales.

    Raises:
        InputError: naming all that is missing or wrong, or if the meshes do not project into the masks.
    """
    complaints, provenance = Complaints(root), Provenance()
    require(root, FILES, complaints)
    complaints.raise_if_any()
    images = find_images(root, settings.cameras)
    if not settings.cameras and (unused := sorted(set(images) & names_of(UNUSED_INDICES))):
        provenance.left_out["cameras in no part of the authors' split"] = shown(unused)
        images = {name: numbers for name, numbers in images.items() if name not in unused}
    sizes = {name: image_size(root, name, min(numbers)) for name, numbers in images.items()}
    written = read_actorshq_cameras(root / CALIBRATION, sizes, complaints)
    complaints.raise_if_any()
    upright = upright_from_set(written.values(), str(root))
    cameras = {name: turned(camera, upright) for name, camera in written.items()}
    numbers = sorted(frozenset().union(*images.values()))
    if settings.mesh and Path(settings.mesh).is_file():
        expected = "a folder of meshes, one per frame, as the actor moves"
        raise InputError(f"import_capture.mesh: expected {expected}, found one file: {settings.mesh}; {MAKES_MESHES}")
    given = meshes_beside(settings.mesh, numbers, MAKES_MESHES)
    into_world = np.concatenate([upright, np.zeros((3, 1))], axis=1).ravel().tolist()
    table = given.table.assign(world_from_mesh=[into_world] * len(given.table))
    tracked = replace(given, table=table, rest=Mesh(given.rest.vertices @ upright.T, given.rest.faces))
    frames = pd.DataFrame({"frame": numbers, "segment": SEGMENT})
    frames, dropped = frames_with_meshes(frames, table.frame.tolist(), str(root))
    if dropped:
        provenance.left_out["frames that lie between no two meshes"] = shown(dropped)
    store = image_store(root, images, sizes, frames.frame.tolist())
    proof = prove_meshes(root, store, cameras, tracked, settings.least_overlap)
    say_given(provenance, proof, store.table)
    middle = posed_vertices(root, tracked, int(table.frame[0])).mean(0)
    lights, patterns = even_light(middle, frames.frame.tolist())
    return ImportedCapture(
        "body", FPS, cameras, frames.assign(timestamp_s=frames.frame / FPS)[["frame", "timestamp_s", "segment"]], store,
        lights, patterns, {}, tracked, held_out(cameras), provenance, constant_light=True,
    )  # fmt: skip


def names_of(indices: Collection[int]) -> set[str]:
    """Names of cameras, which count from 1, by their indices."""
    return {f"Cam{index + 1:03d}" for index in indices}


def find_images(root: Path, wanted: Collection[str]) -> dict[str, frozenset[int]]:
    """Frames with an image, by camera.

    Raises:
        InputError: if there is none, or not one of the `wanted` cameras.
    """
    found: dict[str, frozenset[int]] = {}
    for folder in sorted((root / "rgbs").glob("Cam*")):
        if wanted and folder.name not in wanted:
            continue
        matches = (re.fullmatch(rf"{folder.name}_rgb(\d{{6}})\.jpg", path.name) for path in folder.iterdir())
        if numbers := frozenset(int(match[1]) for match in matches if match):
            found[folder.name] = numbers
    if absent := sorted(set(wanted) - set(found)):
        raise InputError(f"import_capture.cameras: expected cameras with images in {root}/rgbs, found {listed(absent)}")
    if not found:
        raise InputError(f"{root}/rgbs: expected images Cam001/Cam001_rgb000000.jpg and so on, found none")
    return found


def image_path(camera: str, frame: int) -> str:
    """An image, below the set's folder."""
    return f"rgbs/{camera}/{camera}_rgb{frame:06d}.jpg"


def mask_path(camera: str, frame: int) -> str:
    """A mask, below the set's folder."""
    return f"masks/{camera}/{camera}_mask{frame:06d}.png"


def image_size(root: Path, camera: str, frame: int) -> tuple[int, int]:
    """Width and height of an image, pixels."""
    path = root / image_path(camera, frame)
    height, width = decode_stored(read_bytes(path), path).shape[:2]
    return width, height


def image_store(
    root: Path, images: Mapping[str, Collection[int]], sizes: Mapping[str, tuple[int, int]], frames: Collection[int]
) -> ImageStore:
    """The images of the frames, with their masks."""
    rows = [
        (name, frame, image_path(name, frame), mask if (root / mask).is_file() else None)
        for name, numbers in images.items() for frame in frames if frame in numbers
        for mask in [mask_path(name, frame)]
    ]  # fmt: skip
    table = pd.DataFrame(rows, columns=["camera", "frame", "path", "mask_path"])
    table = table.astype({"camera": "str", "frame": "int64", "path": "str", "mask_path": "str"})
    masks = table.mask_path.dropna()
    ones = len(masks) > 0 and read_set_mask(root / masks.iloc[0]).max() == 1
    return ImageStore(table, sizes, "srgb", 0.0, 1, MaskFormat((1,)) if ones else PLAIN_MASKS)


def held_out(cameras: Collection[str]) -> HeldOut:
    """The authors' split of cameras."""
    tested, spare = (sorted(names_of(indices) & set(cameras)) for indices in (TEST_INDICES, VALIDATION_INDICES))
    if len(tested) + len(spare) >= len(cameras):
        raise InputError("import_capture.cameras: expected cameras that train, found those of the authors' test alone")
    if not tested:
        log.warning("none of the cameras is of the authors' test split: no camera is held out")
    return HeldOut(tested, validation_cameras=spare or None)


def say_given(provenance: Provenance, proof: str, images: pd.DataFrame) -> None:
    """Note what the set gave, and what is computed here."""
    provenance.given.update(
        {
            "images": "rgbs, 8-bit JPEG taken for sRGB, in place; their background removed by the set",
            "cameras": f"{CALIBRATION}: axis and angle, world from camera, metres; focal lengths and principal points "
            "times the image's size, from its corner; turned so that y is up",
            "masks": f"masks, for {int(images.mask_path.notna().sum())} of {len(images)} images",
            "meshes": f"import_capture.mesh; {proof}",
            "splits": "the authors' cameras: siggraph_test tests, siggraph_train_validation validates",
        }
    )
    provenance.computed.update(
        {
            "lights": f"{STANDS_FOR}; avatars are not relit",
            "motion of the body": "track_mesh: the rigid motion nearest to the meshes'",
            "texture coordinates": "unwrap_atlas",
        }
    )
    provenance.assumed.update(
        {
            "times": f"{FPS:g} frames a second, which the set does not say; nothing but time stamps depends on it",
            "how images store light": "sRGB, which the set does not say",
            "light": STANDS_FOR,
        }
    )
    provenance.left_out.update(
        {
            "meshes.abc": "other vertices in each frame",
            "aabbs.csv, occupancy_grids": "made of the masks",
            "light_annotations.csv": "pixels of lamps, without places",
        }
    )
