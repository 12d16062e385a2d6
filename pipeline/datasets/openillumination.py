"""OpenIllumination: one still object under one light at a time, or under patterns of lights.

Source: oppo-us-research/OpenIlluminationCapture, `ltsg/utils/util_funcs.py`, which writes the poses, the loaders in
`third_party`, which read them in two ways, and the card of the released set. Meshes there are none.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.errors import Complaints, InputError
from pipeline.config.import_capture import ImportCapture
from pipeline.datasets.imported_capture import OWN_MESH, HeldOut, ImageStore, ImportedCapture, Provenance, TrackedMeshes
from pipeline.datasets.kept_frames import shown
from pipeline.datasets.layout import require
from pipeline.datasets.openillumination_tables import (
    KINDS,
    TEST,
    TRAIN,
    VIEWS,
    LitImages,
    SplitPose,
    find_images,
    lit_images,
    read_poses,
)
from pipeline.datasets.still_images import image_store, wanted_cameras
from pipeline.datasets.still_objects import (
    BLENDER,
    FPS,
    OPENCV,
    Chosen,
    Reading,
    camera_from_pose,
    choose_reading,
    named_mesh,
    say_own_mesh,
    still_frames,
    still_table,
)
from pipeline.datasets.up_axis import turned, upright_from_set
from pipeline.geometry.mesh_files import Mesh

log = logging.getLogger(__name__)

RELEASED = "it is part of the release: download it again"
MASKS, WITH_SUPPORT = "output/obj_masks", "output/com_masks"


def read_openillumination(root: Path, settings: ImportCapture) -> ImportedCapture:
    """One object of one of the `KINDS`, in the world of its cameras turned upright.

    Raises:
        InputError: naming all that is missing or wrong, or if masks and lights do not decide how cameras are meant.
    """
    complaints, provenance = Complaints(root), Provenance()
    if root.parent.name not in KINDS:
        expected = f"a folder of one object in {' or '.join(KINDS)}, which says what its numbers count"
        raise InputError(f"{root}: expected {expected}, found it in {root.parent.name}")
    require(root, dict.fromkeys((VIEWS, MASKS, TRAIN, TEST), RELEASED), complaints)
    complaints.raise_if_any()
    poses = read_poses(root)
    images = wanted_cameras(find_images(root), settings.cameras)
    names = [name for name in sorted(images) if name in poses]
    if uncalibrated := sorted(set(images) - set(names)):
        provenance.left_out["cameras without a pose"] = shown(uncalibrated)
    if blind := sorted(set(poses) - set(images)) if not settings.cameras else []:
        provenance.left_out["cameras without images"] = shown(blind)
    numbers = sorted(set().union(*(images[name] for name in names)) if names else set())
    centers = np.array([pose.world_from_camera[:3, 3] for pose in poses.values()])
    lit = lit_images(root, numbers, centers, settings.light_patterns)
    if not lit.frames:
        raise InputError(f"{root}/{VIEWS}: expected images of cameras with a pose, found {shown(names)}")
    store = image_store(root, names, images, lit.frames, f"{MASKS}/{{}}.png")
    chosen = read_object(root, store, poses, lit.unit, settings)
    upright = upright_from_set(chosen.cameras.values(), str(root))
    cameras = {name: turned(camera, upright) for name, camera in chosen.cameras.items()}
    lights = lit.lights.copy()
    lights[["x", "y", "z"]] = lights[["x", "y", "z"]].to_numpy() @ upright.T
    mesh = Mesh(chosen.mesh.vertices @ upright.T, chosen.mesh.faces)
    say_given(provenance, chosen, lit, store.table)
    say_own_mesh(provenance, settings, chosen, store)
    tracked = TrackedMeshes(still_table(lit.frames, OWN_MESH), 1.0, mesh, in_set=False)
    return ImportedCapture(
        "body", FPS, cameras, still_frames(lit.frames), store, lights, lit.patterns, {}, tracked,
        held_out(names, poses), provenance,
    )  # fmt: skip


def read_object(
    root: Path, store: ImageStore, poses: Mapping[str, SplitPose], unit: float, settings: ImportCapture
) -> Chosen:
    """Cameras in the axes with which they agree with the masks, and the mesh."""
    named, readings = named_mesh(root, settings.mesh, []), {}
    mesh = None if named is None else Mesh(unit * named[1].vertices, named[1].faces)
    for axes in (OPENCV, BLENDER):
        cameras = {}
        for name, (width, height) in store.sizes.items():
            pose = poses[name]
            f = width / 2 / np.tan(pose.angle_x / 2)
            K = np.array([[f, 0, width / 2], [0, f, height / 2], [0, 0, 1]])
            cameras[name] = camera_from_pose(pose.world_from_camera, axes, K, (width, height), unit)
        readings[axes] = Reading(cameras, mesh)
    return choose_reading(root, store, readings, settings)


def held_out(names: list[str], poses: Mapping[str, SplitPose]) -> HeldOut:
    """The set's split: cameras that only its test file lists."""
    tested = [name for name in names if poses[name].tests]
    return HeldOut(tested if len(tested) < len(names) else [])


def say_given(provenance: Provenance, chosen: Chosen, lit: LitImages, images: pd.DataFrame) -> None:
    """Note what the set gave, and what is computed here."""
    masked = int(images.mask_path.notna().sum())
    provenance.assumed["how images store light"] = "sRGB, which the set does not say"
    provenance.given.update(
        {
            "images": f"{VIEWS}, 8-bit, taken for sRGB (see assumed), in place; undistorted by the set",
            "cameras": f"{TRAIN}, {TEST}: {chosen.proof}; {lit.unit_said}; focal lengths by camera_angle_x and the "
            "images' own width, the principal point in the middle; turned so that y is up",
            "lights": lit.lights_said,
            "light patterns": lit.patterns_said,
            "masks": f"{MASKS}, one per camera, for {masked} of {len(images)} images",
            "splits": "cameras that only the test file lists; no light is held out",
        }
    )
    provenance.computed["texture coordinates"] = "unwrap_atlas"
    provenance.left_out.update(
        {
            WITH_SUPPORT: "masks of the object and what it stands on, which is no subject",
            "light_idx, file_path and calib_imgw of the poses": "the folders say which light an image shows",
        }
    )
