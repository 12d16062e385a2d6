"""Meshes of still objects, and the reading of a set in which they lie in its masks.

A set that does not say how its cameras are meant is read in each way that its programs know; the mesh of the object
decides. Where there is no mesh, the masks' visual hull does: read wrongly, they leave nothing or little of it.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float64, UInt8

from pipeline.base.errors import InputError
from pipeline.capture.archives import read_bytes
from pipeline.config.import_capture import ImportCapture
from pipeline.datasets.imported_capture import ImageStore, Provenance
from pipeline.datasets.mask_agreement import Agreement, MaskedView, agreement, decide, prove
from pipeline.datasets.set_masks import read_set_mask
from pipeline.datasets.visual_hull import OutlineView, carve
from pipeline.geometry.cameras import Camera
from pipeline.geometry.mesh_files import Mesh, decode_mesh

log = logging.getLogger(__name__)

MASK_SIDE = 1024
"""Masks are compared at most this large: a pixel is then a thousandth of the object, a cell of its hull some."""

OPENCV, BLENDER = "OpenCV's axes", "Blender's axes"
"""x right, y down, z forward; or x right, y up, z backward."""

FLIPPED = {OPENCV: np.eye(4), BLENDER: np.diag([1.0, -1.0, -1.0, 1.0])}

NOTHING = Agreement(0.0, 0.0)

FPS = 1.0
"""Images a second. The object stands still; nothing depends on it."""


@dataclass(frozen=True)
class Reading:
    """One way to read a set.

    Attributes:
        cameras: at the images' resolution, metres.
        mesh: of the object, in their world, metres; None: it is carved.
    """

    cameras: Mapping[str, Camera]
    mesh: Mesh | None


@dataclass(frozen=True)
class Chosen:
    """The reading that the masks agree with.

    Attributes:
        name: of the reading.
        cameras: of the reading.
        mesh: given, or carved.
        proof: all numbers, for the provenance.
    """

    name: str
    cameras: Mapping[str, Camera]
    mesh: Mesh
    proof: str


@dataclass(frozen=True)
class SmallMask:
    """A mask at most `MASK_SIDE` pixels high and wide.

    What is left over at the end of a side is cut off.

    Attributes:
        mask: 0..255.
        factor: pixels of the image along a side of one of the mask.
    """

    mask: UInt8[np.ndarray, "rows columns"]
    factor: int

    def seen_by(self, camera: Camera) -> OutlineView:
        """The view of a camera whose image the mask belongs to."""
        rows, columns = self.mask.shape
        return OutlineView(replace(camera.downsampled(self.factor), width=columns, height=rows), self.mask)


def camera_from_pose(
    world_from_camera: Float64[np.ndarray, "4 4"], axes: str, K: Float64[np.ndarray, "3 3"], size: tuple[int, int],
    metres_per_unit: float = 1.0,
) -> Camera:  # fmt: skip
    """A camera without distortion, its pose read in `OPENCV`'s or in `BLENDER`'s axes."""
    pose = world_from_camera @ FLIPPED[axes]
    R = pose[:3, :3].T
    return Camera(R.copy(), -R @ (metres_per_unit * pose[:3, 3]), K, np.zeros(5), *size)


def choose_reading(root: Path, store: ImageStore, readings: Mapping[str, Reading], settings: ImportCapture) -> Chosen:
    """The reading whose mesh, or hull, overlaps the masks most.

    Raises:
        InputError: if there are no masks, they do not decide, or what is chosen lies beside them.
    """
    masks = small_masks(root, store)
    if not masks:
        raise InputError(f"{root}: expected masks, which decide how cameras are meant, found none")
    meshes, found = {}, {}
    for name, reading in readings.items():
        views = {camera: mask.seen_by(reading.cameras[camera]) for camera, mask in masks.items()}
        mesh = reading.mesh or carve(list(views.values()), settings.hull_cells)
        found[name] = NOTHING if mesh is None else overlap_of(views, mesh)
        meshes[name] = mesh
    best = decide(found, str(root))
    if readings[best].mesh is None and found[best].overlap < settings.least_overlap:
        raise InputError(
            f"{root}: expected a hull that fills at least {settings.least_overlap:g} of the masks, found "
            f"{found[best].overlap:.3f}: cameras and masks contradict each other, or there are few of them; name a "
            "mesh by import_capture.mesh"
        )
    both = ", ".join(f"{name} {each.overlap:.3f}" for name, each in found.items())
    proof = f"read in {best}, as the masks decide ({both}); {prove(found[best], settings.least_overlap, str(root))}"
    return Chosen(best, readings[best].cameras, meshes[best], proof)


def small_masks(root: Path, store: ImageStore) -> dict[str, SmallMask]:
    """The mask of each camera that has one."""
    masks = {}
    for row in store.table[store.table.mask_path.notna()].drop_duplicates("camera").itertuples():
        path, (width, height) = root / row.mask_path, store.sizes[row.camera]
        mask = store.masks.fit(read_set_mask(path), (height, width), path)
        factor = -(-max(mask.shape) // MASK_SIDE)
        rows, columns = mask.shape[0] // factor, mask.shape[1] // factor
        cut = mask[: rows * factor, : columns * factor].reshape(rows, factor, columns, factor)
        masks[row.camera] = SmallMask(np.round(cut.mean((1, 3))).astype(np.uint8), factor)
    return masks


def overlap_of(views: Mapping[str, OutlineView], mesh: Mesh) -> Agreement:
    """Agreement of one mesh with the masks of all views."""
    masked = [MaskedView(name, view.mask, mesh.vertices) for name, view in views.items()]
    return agreement(masked, {name: view.camera for name, view in views.items()}, mesh.faces)


def named_mesh(root: Path, named: str, own: Sequence[Path]) -> tuple[Path, Mesh] | None:
    """The object's mesh and its file: the `named` one, else the set's `own`, else None.

    Raises:
        InputError: if it cannot be read, has no faces, or the set has several.
    """
    if not named and len(own) > 1:
        names = ", ".join(str(path.relative_to(root)) for path in own)
        raise InputError(f"{root}: expected one mesh, found {names}; name one by import_capture.mesh")
    path = Path(named) if named else next(iter(own), None)
    if path is None:
        return None
    mesh = decode_mesh(read_bytes(path), path)
    if not len(mesh.faces):
        raise InputError(f"{path}: expected a mesh with faces, found vertices alone")
    return path, mesh


def still_table(frames: Sequence[int], path: str) -> pd.DataFrame:
    """Table of one mesh that is the same, where it is, in all frames."""
    still = np.eye(3, 4).ravel().tolist()
    return pd.DataFrame({"frame": list(frames), "path": path, "world_from_mesh": [still] * len(frames)})


def still_frames(frames: Sequence[int]) -> pd.DataFrame:
    """Table of frames: their numbers are those of the images."""
    return pd.DataFrame({"frame": list(frames), "timestamp_s": np.array(frames) / FPS, "segment": "object"})


def say_own_mesh(provenance: Provenance, settings: ImportCapture, chosen: Chosen, store: ImageStore) -> None:
    """Note where a mesh is from that is not in the set."""
    if settings.mesh:
        provenance.given["meshes"] = f"{Path(settings.mesh).name} of import_capture.mesh, the same in all frames"
        return
    count = store.table[store.table.mask_path.notna()].camera.nunique()
    hull = f"visual hull of {count} masks, {len(chosen.mesh.vertices)} vertices"
    provenance.computed["meshes"] = f"import_capture: {hull}, for lack of a mesh; it has no hollows"
