"""HumanOLAT: one pose of a still person under one light at a time.

Source: TMT22/HumanOLAT, `DATASHEET.md` and `code/utils/metadata_readers.py`. Its own programs disagree about the
direction of the cameras' matrices: the model is projected into the masks both ways.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.errors import Complaints, InputError
from pipeline.capture.archives import read_bytes
from pipeline.config.import_capture import ImportCapture
from pipeline.datasets.environment_weights import (
    StageImages,
    environment_patterns,
    no_environments,
    with_environments,
)
from pipeline.datasets.humanolat_cameras import (
    FROM_CAMERA,
    FROM_WORLD,
    METRES_PER_UNIT,
    read_calib,
    vote_of_origins,
)
from pipeline.datasets.humanolat_images import (
    CALIBRATION,
    EARLIER_IMAGES,
    FIRST_SKIPPED,
    FULL_IMAGE,
    IMAGES,
    LIGHTS,
    MASKS,
    MODEL,
    ORDER,
    SKIP_STEP,
    image_of,
    read_light_points,
    read_order,
)
from pipeline.datasets.imported_capture import HeldOut, ImageStore, ImportedCapture, Provenance, TrackedMeshes
from pipeline.datasets.kept_frames import shown
from pipeline.datasets.layout import find_shared, require
from pipeline.datasets.light_durations import light_name
from pipeline.datasets.mask_agreement import agreement, decide, masked_views, prove
from pipeline.datasets.still_images import find_images, image_store
from pipeline.geometry.cameras import Camera
from pipeline.geometry.mesh_files import Mesh, decode_mesh

log = logging.getLogger(__name__)

RELEASED = "it is part of the release: download it again"
DOOR_LIGHTS = (178, 179, *range(208, 211), *range(237, 241), *range(267, 272), *range(295, 299), *range(319, 322))
"""Lights on the stage's door, counted from 0: what their images show is left out, as by the set's authors."""

FPS = 1.0
"""Images a second. The subject stands still; nothing depends on it."""

TEST_EVERY, TRAIN_STEP = 5, 3
"""Split of the authors' example (code/run_json_writer_example.py), which counts cameras from 0, and lights in the order
of firing without those on the door: every fifth camera tests; every third light trains, the next tests."""


def read_humanolat(root: Path, settings: ImportCapture) -> ImportedCapture:
    """One pose of one person.

    Raises:
        InputError: naming all that is missing or wrong, or if the masks do not decide how cameras are meant.
    """
    shared, complaints = find_shared(root), Complaints(root)
    require(root, {MODEL: RELEASED, MASKS: RELEASED, IMAGES: RELEASED}, complaints)
    require(shared, {CALIBRATION: RELEASED, LIGHTS: RELEASED, ORDER: RELEASED}, complaints)
    complaints.raise_if_any()
    provenance, written = Provenance(), read_calib(shared / CALIBRATION)
    lights = read_light_points(shared / LIGHTS)
    order = read_order(shared / ORDER, len(lights))
    images = find_images(root, IMAGES, settings.cameras)
    names = [name for name in sorted(images) if name in written]
    if uncalibrated := sorted(set(images) - set(names)):
        provenance.left_out["cameras without a calibration"] = shown(uncalibrated)
    lit_by = {FULL_IMAGE: None} | {image_of(k): light for k, light in enumerate(order) if light not in DOOR_LIGHTS}
    there = set().union(*(images[name] for name in names)) if names else set()
    frames = [number for number in sorted(lit_by) if number in there]
    if FULL_IMAGE not in frames or len(frames) < 2 + TRAIN_STEP:
        expected = f"image {FULL_IMAGE} and those of single lights"
        raise InputError(f"{root}/{IMAGES}: expected {expected}, found {shown(frames)}")
    if absent := sorted(set(lit_by) - set(frames)):
        log.warning("%d lights have no image; left out: images %s", len(absent), absent)
        provenance.left_out["lights without an image"] = shown(absent)
    split = held_out(names, frames, order)
    environments = no_environments()
    if settings.environments:
        lit = {image_of(k): light_name(light) for k, light in enumerate(order)}
        stage = StageImages(root, images, lit, FULL_IMAGE)
        trained, alone = [name for name in names if name not in split.cameras], dict.fromkeys(lights.light, 1.0)
        environments = environment_patterns(stage, trained, EARLIER_IMAGES, alone, provenance)
    frames = sorted({*frames, *environments.frame})
    model = decode_mesh(read_bytes(root / MODEL), root / MODEL)
    if not len(model.faces):
        raise InputError(f"{root / MODEL}: expected a mesh with faces, found vertices alone; {RELEASED}")
    rest = Mesh(METRES_PER_UNIT * model.vertices, model.faces)
    still = np.eye(3, 4).ravel().tolist()
    table = pd.DataFrame({"frame": frames, "path": MODEL, "world_from_mesh": [still] * len(frames)})
    tracked = TrackedMeshes(table, METRES_PER_UNIT, rest)
    store = image_store(root, names, images, frames, f"{MASKS}/{{}}.png")
    cameras, said = choose_direction(root, written, store, tracked, settings.least_overlap)
    say_given(provenance, said, store.table)
    on = {n: [light_name(light)] if light is not None else lights.light.tolist() for n, light in lit_by.items()}
    patterns = [(n, light, 1.0) for n in frames if n in on for light in on[n]]
    return ImportedCapture(
        "body", FPS, cameras, pd.DataFrame({"frame": frames, "timestamp_s": np.array(frames) / FPS, "segment": "pose"}),
        store, lights, with_environments(patterns, environments), {}, tracked,
        replace(split, frames=sorted(set(environments.frame))), provenance,
    )  # fmt: skip


def choose_direction(
    root: Path, written: Mapping, store: ImageStore, tracked: TrackedMeshes, least_inside: float
) -> tuple[dict[str, Camera], str]:
    """Cameras, read in the direction that projects the model into the masks, and why.

    Raises:
        InputError: if the masks do not decide, or the lines `origin` say otherwise.
    """
    views = masked_views(root, store, tracked)
    if not views:
        raise InputError(f"{root}/{MASKS}: expected masks, which decide how cameras are meant, found none; {RELEASED}")
    read = {d: {n: written[n].as_camera(d, size) for n, size in store.sizes.items()} for d in (FROM_WORLD, FROM_CAMERA)}
    found = {direction: agreement(views, cameras, tracked.rest.faces) for direction, cameras in read.items()}
    best, vote = decide(found, str(root)), vote_of_origins({name: written[name] for name in store.sizes})
    if vote not in (None, best):
        expected = f"lines origin that agree with the masks ({best})"
        raise InputError(f"{root}: {CALIBRATION}: expected {expected}, found that they say {vote}")
    both = ", ".join(f"{direction} {found[direction].overlap:.3f}" for direction in read)
    proof = prove(found[best], least_inside, str(root))
    return read[best], f"extrinsics read as {best}, as the masks decide ({both}); {proof}"


def held_out(names: list[str], frames: list[int], order: list[int]) -> HeldOut:
    """The authors' split: every fifth camera and a third of the lights; one more validates."""
    tested = [name for name in names if (int(re.sub(r"\D", "", name)) - 1) % TEST_EVERY == 0]
    shown_by = [image_of(k) for k, light in enumerate(order) if light not in DOOR_LIGHTS]
    patterns = [number for number in shown_by[1::TRAIN_STEP] if number in frames]
    spare = [number for number in shown_by[2::TRAIN_STEP] if number in frames]
    return HeldOut(tested if len(tested) < len(names) else [], patterns=patterns, validation_patterns=spare)


def say_given(provenance: Provenance, cameras: str, images: pd.DataFrame) -> None:
    """Note what the set gave, and what is computed here."""
    masked = int(images.mask_path.notna().sum())
    provenance.given.update(
        {
            "images": f"{IMAGES}, 8-bit sRGB, in place; undistorted and masked by the set",
            "cameras": f"{CALIBRATION}: {cameras}; intrinsics times the image's width, counted from its corner",
            "lights": f"{LIGHTS}, metres; intensity 1 each",
            "light patterns": f"{ORDER}: image {FULL_IMAGE} has all lights, the following one each in that order, but "
            f"for {FIRST_SKIPPED}, {FIRST_SKIPPED + SKIP_STEP} and so on",
            "masks": f"{MASKS}, one per camera, for {masked} of {len(images)} images",
            "meshes": f"{MODEL}, the same in all frames",
            "splits": "every fifth camera from the first; of the order of firing, without the lights on the door, the "
            "lights [1::3] test, [0::3] train, the rest validates",
        }
    )
    provenance.computed.update({"texture coordinates": "unwrap_atlas"})
    provenance.left_out.update(
        {
            "image 0, and every 21st from 34": "repeats of full light",
            "lights on the door": "left out by the set's authors",
            "openpose": "joints inside a mesh that has no skeleton; the set does not say of which size of images",
            "smpl-x": "the pose is still, and the mesh is the subject's own",
        }
    )
