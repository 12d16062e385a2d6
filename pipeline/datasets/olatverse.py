"""OLATverse: one still object under one light at a time, in HumanOLAT's stage.

Source: xilongzhou/OLATverse, `README.md`; gsrelight/gs-relight, `scene/dataset_readers.py`, reads the same poses. The
README does not say how matrices are meant, in which unit they and the mesh are: all is decided by the lights, whose
metres are known, and by the masks.
"""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path

import pandas as pd

from pipeline.base.errors import Complaints, InputError
from pipeline.config.import_capture import ImportCapture
from pipeline.datasets.environment_weights import (
    StageImages,
    environment_patterns,
    no_environments,
    with_environments,
)
from pipeline.datasets.imported_capture import OWN_MESH, ImageStore, ImportedCapture, Provenance, TrackedMeshes
from pipeline.datasets.kept_frames import shown
from pipeline.datasets.layout import find_shared, require
from pipeline.datasets.light_durations import light_name
from pipeline.datasets.olatverse_tables import (
    CAMERAS,
    LIGHTS,
    SPLITS,
    UNITS,
    WrittenPose,
    chosen_unit,
    read_lights,
    read_poses,
    read_split,
)
from pipeline.datasets.still_images import find_images, image_store
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
from pipeline.geometry.mesh_files import SUFFIXES, Mesh

log = logging.getLogger(__name__)

RELEASED = "it is part of the release: download it again"
SHARED = "it is in the folder shared of the set's repository, xilongzhou/OLATverse: put that beside the objects"

IMAGES, MASKS, MODEL = "masked_olat", "mask", "model"
FULL_IMAGE = 14
"""Number of the image with all lights on, before those of single lights; others of full light repeat it."""

EARLIER_IMAGES = range(1, FULL_IMAGE)
"""Images of environments."""

POLARISED = ("Cam07", "Cam10", "Cam17", "Cam22", "Cam39")
"""Cameras behind polarisers, whose images are darker; the authors' benchmark leaves them out."""


def read_olatverse(root: Path, settings: ImportCapture) -> ImportedCapture:
    """One object.

    Raises:
        InputError: naming all that is missing or wrong, or if lights and masks do not decide how cameras are meant.
    """
    shared, complaints, provenance = find_shared(root), Complaints(root), Provenance()
    require(root, dict.fromkeys((IMAGES, MASKS, CAMERAS), RELEASED), complaints)
    require(shared, {LIGHTS: SHARED}, complaints)
    complaints.raise_if_any()
    lights, poses = read_lights(shared / LIGHTS), read_poses(root / CAMERAS)
    images = find_images(root, IMAGES, settings.cameras)
    names = taken_cameras(images, poses, settings.cameras, provenance)
    lit_by = {FULL_IMAGE: list(lights.intensities)} | {number: [light] for light, number in lights.image_of.items()}
    there = set().union(*(images[name] for name in names)) if names else set()
    frames = [number for number in sorted(lit_by) if number in there]
    if FULL_IMAGE not in frames or len(frames) < 2:
        expected = f"image {FULL_IMAGE} and those of single lights, of calibrated cameras"
        raise InputError(f"{root}/{IMAGES}: expected {expected}, found {shown(frames)}")
    if absent := sorted(set(lit_by) - set(frames)):
        log.warning("%d lights have no image; left out: images %s", len(absent), absent)
        provenance.left_out["lights without an image"] = shown(absent)
    split, environments = read_split(root, names, lights), no_environments()
    if settings.environments:
        single = {number: light_name(light) for light, number in lights.image_of.items()}
        stage = StageImages(root, images, single, FULL_IMAGE)
        shades = {light_name(light): shade for light, shade in lights.intensities.items()}
        trained = [name for name in names if name not in split.cameras]
        environments = environment_patterns(stage, trained, EARLIER_IMAGES, shades, provenance)
    frames = sorted({*frames, *environments.frame})
    store = image_store(root, names, images, frames, f"{MASKS}/{{}}.png")
    unit, why = chosen_unit(poses, lights.places, str(root))
    chosen, meshes = read_object(root, store, poses, unit, frames, settings)
    say_given(provenance, chosen, why, store.table, split.origin)
    if meshes.in_set:
        provenance.given["meshes"] = f"{meshes.table.path[0]}, the same in all frames"
    else:
        say_own_mesh(provenance, settings, chosen, store)
    alone = [(n, light_name(k), lights.intensities[k]) for n in frames if n in lit_by for k in lit_by[n]]
    return ImportedCapture(
        "body", FPS, chosen.cameras, still_frames(frames), store, lights.table(),
        with_environments(alone, environments), {}, meshes,
        replace(split.held_out(frames), frames=sorted(set(environments.frame))), provenance,
    )  # fmt: skip


def taken_cameras(
    images: Mapping[str, object], poses: Mapping[str, WrittenPose], wanted: Collection[str], provenance: Provenance
) -> list[str]:
    """Names of the calibrated cameras, polarised ones only if they are asked for."""
    dark = [name for name in sorted(images) if name in POLARISED and name not in wanted]
    names = [name for name in sorted(images) if name in poses and name not in dark]
    if uncalibrated := sorted(set(images) - set(poses)):
        provenance.left_out["cameras without a calibration"] = shown(uncalibrated)
    if blind := sorted(set(poses) - set(images)) if not wanted else []:
        provenance.left_out["cameras without images"] = shown(blind)
    if dark:
        provenance.left_out["cameras behind polarisers"] = f"{shown(dark)}; import_capture.cameras takes them by name"
    return names


def read_object(
    root: Path, store: ImageStore, poses: Mapping[str, WrittenPose], unit: float, frames: list[int],
    settings: ImportCapture,
) -> tuple[Chosen, TrackedMeshes]:  # fmt: skip
    """Cameras and mesh in the axes and the unit with which they agree with the masks."""
    own = sorted(path for path in (root / MODEL).glob("*") if path.suffix.lower() in SUFFIXES)
    named, readings = named_mesh(root, settings.mesh, own), {}
    for axes in (BLENDER, OPENCV):
        cameras = {
            name: camera_from_pose(poses[name].world_from_camera, axes, poses[name].K, size, unit)
            for name, size in store.sizes.items()
        }
        if named is None:
            readings[axes] = Reading(cameras, None)
            continue
        for metres, word in UNITS.items():
            mesh = Mesh(metres * named[1].vertices, named[1].faces)
            readings[f"{axes} and a mesh in {word}"] = Reading(cameras, mesh)
    chosen = choose_reading(root, store, readings, settings)
    if named is None or named[0] not in own:
        return chosen, TrackedMeshes(still_table(frames, OWN_MESH), 1.0, chosen.mesh, in_set=False)
    scale = next(metres for metres, word in UNITS.items() if chosen.name.endswith(f" {word}"))
    path = str(named[0].relative_to(root))
    return chosen, TrackedMeshes(still_table(frames, path), scale, chosen.mesh)


def say_given(provenance: Provenance, chosen: Chosen, unit: str, images: pd.DataFrame, split: str) -> None:
    """Note what the set gave, and what is computed here."""
    masked = int(images.mask_path.notna().sum())
    provenance.given.update(
        {
            "images": f"{IMAGES}, 8-bit sRGB, in place; masked by the set, and twice as bright as recorded",
            "cameras": f"{CAMERAS}: {chosen.proof}; {unit}",
            "lights": f"{LIGHTS}, metres, entries of one light once; intensity pl_intensity",
            "light patterns": f"{LIGHTS}: the image of each light; image {FULL_IMAGE} has all of them",
            "masks": f"{MASKS}, one per camera, for {masked} of {len(images)} images",
            "splits": split,
        }
    )
    provenance.computed["texture coordinates"] = "unwrap_atlas"
    provenance.left_out.update(
        {
            "image 0, and those of full light after 14": "repeats of full light",
            "pbr, normal_benchmark": "estimates of another method, no photographs",
            f"file_path of {SPLITS[0]} and {SPLITS[1]}": f"cameras and lights are taken; images are those of {IMAGES}",
        }
    )
