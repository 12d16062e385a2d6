"""Projection of a set's meshes into its masks.

It is the proof that cameras, poses and units are read as they are meant.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64, UInt8

from pipeline.base.errors import InputError
from pipeline.base.spread import evenly
from pipeline.capture.archives import read_bytes
from pipeline.datasets.imported_capture import ImageStore, TrackedMeshes
from pipeline.datasets.set_masks import read_set_mask
from pipeline.geometry.cameras import Camera
from pipeline.geometry.mesh_files import decode_mesh
from pipeline.geometry.signed_distance import draw_silhouette

log = logging.getLogger(__name__)

PROVEN_FRAMES, PROVEN_CAMERAS = 3, 8
"""Masks that meshes are projected into, evenly chosen."""

HALF = 128
"""Coverage and mask values from which a pixel counts: half of it."""

CLEAR_MARGIN = 0.2
"""By how much the overlap of one convention has to exceed that of any other: masks with hair and cloth that no mesh has
take a tenth off both, a wrong direction of cameras nearly all."""


@dataclass(frozen=True)
class MaskedView:
    """A mask with the mesh of its frame.

    Attributes:
        camera: its name.
        mask: 0..255, of the image's size.
        vertices: of the mesh, in the world, metres.
    """

    camera: str
    mask: UInt8[np.ndarray, "height width"]
    vertices: Float64[np.ndarray, "vertices 3"]


@dataclass(frozen=True)
class Agreement:
    """Agreement of projected meshes and masks, pooled over all views.

    Attributes:
        inside: share of the projected meshes that lies in the masks; 0 if they project nowhere.
        overlap: intersection over union.
    """

    inside: float
    overlap: float


def agreement(
    views: Sequence[MaskedView], cameras: Mapping[str, Camera], faces: Int64[np.ndarray, "faces 3"]
) -> Agreement:
    """Project each view's mesh into its mask.

    Args:
        cameras: at the resolution of the masks.
    """
    drawn = common = either = 0
    for view in views:
        mesh, mask = draw_silhouette(cameras[view.camera], view.vertices, faces) >= HALF, view.mask >= HALF
        drawn, common = drawn + np.count_nonzero(mesh), common + np.count_nonzero(mesh & mask)
        either += np.count_nonzero(mesh | mask)
    return Agreement(common / max(drawn, 1), common / max(either, 1))


def prove(found: Agreement, least_inside: float, what: str) -> str:
    """A sentence about the agreement, which is logged.

    Raises:
        InputError: if less than `least_inside` of the meshes lies in the masks.
    """
    said = f"{found.inside:.3f} of the projected meshes lies in the masks, overlap {found.overlap:.3f}"
    log.info("%s: %s", what, said)
    if found.inside < least_inside:
        raise InputError(
            f"{what}: expected at least {least_inside:g} of the projected meshes in the masks, found "
            f"{found.inside:.3f} (overlap {found.overlap:.3f}); is this the layout that the set shipped? A smaller "
            "import_capture.least_overlap goes on all the same"
        )
    return said


def prove_meshes(
    root: Path, store: ImageStore, cameras: Mapping[str, Camera], meshes: TrackedMeshes, least_inside: float
) -> str:
    """Project some meshes into their masks; a sentence on how they fit.

    Raises:
        InputError: if they do not.
    """
    views = masked_views(root, store, meshes)
    if not views:
        log.warning("no masks: whether cameras and meshes fit each other is not known")
        return "not checked: there are no masks"
    small = {name: camera.downsampled(float(store.downsample_from_sensor)) for name, camera in cameras.items()}
    return prove(agreement(views, small, meshes.rest.faces), least_inside, str(root))


def masked_views(root: Path, store: ImageStore, meshes: TrackedMeshes) -> list[MaskedView]:
    """Some masks with the meshes of their frames, evenly chosen; none if the set has no masks."""
    masked = store.table[store.table.mask_path.notna() & store.table.frame.isin(meshes.table.frame)]
    frames = evenly(sorted(masked.frame.unique().tolist()), PROVEN_FRAMES)
    names = evenly(sorted(masked.camera.unique().tolist()), PROVEN_CAMERAS)
    posed = {frame: posed_vertices(root, meshes, frame) for frame in frames}
    chosen = masked[masked.frame.isin(frames) & masked.camera.isin(names)]
    masks = {}
    for row in chosen.drop_duplicates("mask_path").itertuples():  # Images of a still subject share them.
        path, (width, height) = root / row.mask_path, store.sizes[row.camera]
        masks[row.mask_path] = store.masks.fit(read_set_mask(path), (height, width), path)
    return [MaskedView(row.camera, masks[row.mask_path], posed[row.frame]) for row in chosen.itertuples()]


def posed_vertices(root: Path, meshes: TrackedMeshes, frame: int) -> Float64[np.ndarray, "vertices 3"]:
    """Vertices of a frame's mesh in the world, metres."""
    row = meshes.table.set_index("frame").loc[frame]
    path = meshes.file(root, row.path)
    vertices = meshes.scale_to_m * decode_mesh(read_bytes(path), path).vertices
    if row.world_from_mesh is None:
        return vertices
    motion = np.array(row.world_from_mesh, np.float64).reshape(3, 4)
    return vertices @ motion[:, :3].T + motion[:, 3]


def decide(found: Mapping[str, Agreement], what: str) -> str:
    """The convention whose meshes overlap the masks most; all numbers are logged.

    Raises:
        InputError: if two are so close that the masks do not decide.
    """
    for name, each in found.items():
        log.info("%s: read as %s: overlap %.3f, %.3f of the meshes inside", what, name, each.overlap, each.inside)
    ranked = sorted(found, key=lambda name: found[name].overlap, reverse=True)
    if len(ranked) > 1 and found[ranked[0]].overlap - found[ranked[1]].overlap < CLEAR_MARGIN:
        numbers = ", ".join(f"{name}: {found[name].overlap:.3f}" for name in ranked)
        raise InputError(
            f"{what}: expected one convention to overlap the masks by {CLEAR_MARGIN:g} more than the others, found "
            f"{numbers}; give masks of more cameras, or report the set's layout"
        )
    return ranked[0]
