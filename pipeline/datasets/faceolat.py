"""FaceOLAT: one expression of one person under one light at a time.

Source: prraoo/FaceOLAT, `color-calibration/exr2avif.py`, `relighting/render_reference_envmap_relit.py` and
`calibration/README.md`. Images are numbered from 1 and the list of patterns from 0; the set's own programs take them
for the same numbers in one place and not in another, so the images' brightness decides. The set ships no meshes.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.errors import InputError
from pipeline.capture.images import ImageSource
from pipeline.config.import_capture import ImportCapture
from pipeline.datasets.faceolat_cameras import fitted_sphere, read_faceolat_cameras
from pipeline.datasets.faceolat_files import (
    FRAME_FILE,
    PATTERN_FILE,
    TRANSFER,
    CaptureName,
    brightness,
    choose_capture,
    find_images,
    find_programs,
    image_store,
)
from pipeline.datasets.frame_numbering import first_image, numbers_to_read
from pipeline.datasets.imported_capture import HeldOut, ImportedCapture, Provenance, TrackedMeshes
from pipeline.datasets.kept_frames import frames_with_meshes, shown
from pipeline.datasets.light_durations import (
    FULLY_LIT,
    intensities,
    lit_lights,
    read_durations,
    read_lights,
    read_pattern_of_frames,
)
from pipeline.datasets.mesh_brightness import say_brightness
from pipeline.datasets.meshes_beside import meshes_beside

log = logging.getLogger(__name__)

METRES_PER_UNIT = 0.001
"""Of the lights."""

FPS = 1.0
"""Images a second. The subject holds still; nothing depends on it."""

FIRST_IMAGES = (1, 0)
"""Image that entry 0 of the list of patterns may be of: the two readings of the set's own programs."""

TEST_EVERY, TRAIN_STEP = 5, 3
"""A split like that of another set of the same stage (HumanOLAT), as this one has none within a capture."""

MAKES_MESHES = "calibration/run_recon.sh of the set's programs makes one with Metashape: model.obj, of fully lit images"


def read_faceolat(root: Path, settings: ImportCapture) -> ImportedCapture:
    """One capture: an expression of a person.

    Raises:
        InputError: naming all that is missing or wrong, or if brightness does not decide which image shows which light.
    """
    capture, provenance = choose_capture(root, settings.segments), Provenance()
    programs = find_programs(root, capture)
    lights = read_lights(programs / PATTERN_FILE, METRES_PER_UNIT)
    patterns = read_durations(programs / PATTERN_FILE, "light_patterns", len(lights))
    listed_patterns = read_pattern_of_frames(programs / FRAME_FILE, len(patterns))
    images = find_images(root, capture, settings.cameras)
    places = lights[["x", "y", "z"]].to_numpy(np.float64)
    cameras, unit = read_faceolat_cameras(programs / capture.calibration, list(images), places)
    if uncalibrated := sorted(set(images) - set(cameras)):
        provenance.left_out["cameras without a calibration"] = shown(uncalibrated)
    fully_lit = [entry for entry, pattern in listed_patterns.items() if pattern == FULLY_LIT]
    light_of = brightness(root, {name: images[name] for name in cameras}, numbers_to_read(fully_lit, FIRST_IMAGES))
    first = first_image(light_of, fully_lit, FIRST_IMAGES, f"{root}: {capture.text}")
    pattern_of = {entry + first: pattern for entry, pattern in listed_patterns.items()}
    there = set().union(*(images[name] for name in cameras))
    numbers = sorted(there & set(pattern_of))
    if spare := sorted(there ^ set(pattern_of)):
        log.warning("images without a pattern, or patterns without an image; left out: %s", spare)
        provenance.left_out["images without a pattern, patterns without an image"] = shown(spare)
    tracked = meshes_beside(settings.mesh, numbers, MAKES_MESHES)
    require_in_dome(tracked, places, settings.mesh)
    frames = pd.DataFrame({"frame": numbers, "segment": capture.text})
    frames, dropped = frames_with_meshes(frames, tracked.table.frame.tolist(), str(root))
    if dropped:
        provenance.left_out["frames that lie between no two meshes"] = shown(dropped)
    kept = frames.frame.tolist()
    store = image_store(root, images, cameras, kept)
    lit = lit_lights(patterns, len(lights), provenance)
    full = max(duration for pattern in patterns for duration in pattern.values())
    source = ImageSource(root, TRANSFER, 0.0)
    seen = say_brightness(source, store, cameras, tracked, [n for n in kept if pattern_of[n] == FULLY_LIT])
    say_given(provenance, capture, unit, f"entry 0 is image {first}", full, f"{len(tracked.table)} frames; {seen}")
    colors = {name: capture.exposure * np.eye(3) for name in cameras} if capture.exposure != 1 else {}
    return ImportedCapture(
        "head", FPS, cameras, frames.assign(timestamp_s=frames.frame / FPS)[["frame", "timestamp_s", "segment"]], store,
        lights[lights.light.isin(lit)].reset_index(drop=True), intensities(kept, pattern_of, patterns, full), colors,
        tracked, held_out(sorted(cameras), kept, pattern_of), provenance,
    )  # fmt: skip


def require_in_dome(tracked: TrackedMeshes, lights: np.ndarray, setting: str) -> None:
    """Refuse meshes of another frame or unit.

    Raises:
        InputError: if the first mesh is not in the inner half of the dome of lights, or larger than that.
    """
    center, radius = fitted_sphere(lights)
    away = np.linalg.norm(tracked.rest.vertices - center, axis=1)
    if np.median(away) > 0.5 * radius:
        raise InputError(
            f"import_capture.mesh: {setting}: expected a mesh in metres in the frame of cameras and lights, whose dome "
            f"has its middle at {center.round(3).tolist()} and a radius of {radius:.3f} m, found vertices "
            f"{np.median(away):.3f} m away from there (median)"
        )


def held_out(cameras: Sequence[str], frames: Sequence[int], pattern_of: Mapping[int, int]) -> HeldOut:
    """Every fifth camera and a third of the single lights; one more validates."""
    tested = [name for name in cameras if int(re.sub(r"\D", "", name)) % TEST_EVERY == 0]
    single = [number for number in frames if pattern_of[number] != FULLY_LIT]
    tests, spare = single[1::TRAIN_STEP], single[2::TRAIN_STEP]
    return HeldOut(tested if len(tested) < len(cameras) else [], patterns=tests, validation_patterns=spare)


def say_given(
    provenance: Provenance, capture: CaptureName, cameras: str, numbering: str, full: float, meshes: str
) -> None:
    """Note what the set gave, and what is computed here."""
    exposure = f", times {capture.exposure:g}, as the set's program re-exposes it" if capture.exposure != 1 else ""
    provenance.given.update(
        {
            "images": f"Cam*/{capture.text}, 8-bit AVIF of light to the power of 1 / 2.2, in place{exposure}",
            "cameras": f"{capture.calibration}: Metashape's export, world from camera, principal points from the "
            f"images' middle; {cameras}",
            "lights": f"{PATTERN_FILE}, mm; intensity = duration / {full:g}, the longest, fractions kept",
            "light patterns": f"{FRAME_FILE}; {numbering}, as brightness decides",
            "colour": "the set's own matrix, which its images have gone through",
            "meshes": f"import_capture.mesh, {meshes}",
        }
    )
    provenance.computed.update(
        {
            "masks": "pack_shards: outlines of the meshes",
            "meshes of frames without one": "track_mesh: interpolated with the rigid motion nearest to the meshes'",
            "texture coordinates": "unwrap_atlas",
            "splits": "cameras whose number divides by 5; of the single lights [1::3] test, [2::3] validate: the set "
            "has no split within a capture",
        }
    )
    provenance.left_out["colorcalib_exr.mat"] = "images that the set's programs write have gone through it"
