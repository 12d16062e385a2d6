"""Records of a chunk: images as foreground crops, frames with light and geometry."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.errors import Complaints
from pipeline.base.progress import progress
from pipeline.base.splits import TEST_FLAGS, VALIDATION
from pipeline.capture.crops import cut_crop, mesh_silhouette
from pipeline.capture.images import ImageSource, read_exr_channel
from pipeline.capture.records import FrameRecord, ImageRecord
from pipeline.capture.shards import MASK_LEVELS
from pipeline.capture.shared_masks import SharedMasks
from pipeline.capture.undistortion import LensMaps, left_out
from pipeline.config.pack_shards import PackShards
from pipeline.geometry.cameras import Camera
from pipeline.geometry.texels import Atlas

log = logging.getLogger("pack_shards")

EFFECTS = ("color_correction", "lens_distortion")
"""Those that correct images."""


@dataclass(frozen=True)
class ChunkInputs:
    """Everything read before the images.

    `patterns` are those of the chunk, with the positions of their lights. `heads`, `gazes` and `textures` are by frame,
    as in `FrameRecord`; empty if there are none.
    """

    source: ImageSource
    on: dict[str, bool]
    booked: pd.DataFrame
    vertices: dict[int, np.ndarray]
    cameras: dict[str, Camera]
    colors: dict[str, np.ndarray]
    atlas: Atlas
    patterns: pd.DataFrame
    irradiance: Path | None
    heads: dict[int, np.ndarray]
    gazes: dict[int, np.ndarray]
    textures: dict[int, np.ndarray]


def require_inputs(inputs: ChunkInputs, images: pd.DataFrame, effects: Path) -> None:
    """Refuse a chunk whose inputs lack something, before any image is read.

    Raises:
        InputError: naming everything that is missing, before any image is read.
    """
    complaints = Complaints("pack_shards")
    for name in [name for name in EFFECTS if name not in inputs.on]:
        complaints.add(effects, name, expected="an effect", found="none", hint="run plan_effects again")
    for camera in sorted(set(images.camera) - set(inputs.cameras)):
        complaints.add("--cameras", camera, expected="a calibrated camera, as it has images", found="none")
    if inputs.on.get("color_correction"):
        for camera in sorted(set(images.camera) - set(inputs.colors)):
            complaints.add("--color", camera, expected="a matrix, as colour correction is on", found="none")
    for frame in [n for n in inputs.booked.index.tolist() if n not in inputs.vertices]:
        complaints.add("--tracking", f"frame {frame}", expected="tracked vertices", found="none")
    for light in sorted(inputs.patterns.light[inputs.patterns.x.isna()].unique()):
        complaints.add("--lights", light, expected="a position, as it is lit", found="none")
    for frame in inputs.booked.index.tolist() if inputs.irradiance else []:
        if not irradiance_file(inputs.irradiance, frame).exists():
            complaints.add("--irradiance", f"frame {frame}", expected="a map", found="none")
    for frame in inputs.booked.index.tolist() if inputs.textures else []:
        if frame not in inputs.textures:
            complaints.add("--textures", f"frame {frame}", expected="a mean texture", found="none")
    complaints.raise_if_any()


def irradiance_file(folder: Path, frame: int) -> Path:
    """File of a frame's map, as trace_irradiance writes it."""
    return folder / f"{frame:06d}.exr"


def crop_images(images: pd.DataFrame, inputs: ChunkInputs, settings: PackShards) -> Iterator[ImageRecord]:
    """Read, correct and cut the images one by one.

    Those without foreground are left out, with a warning.
    """
    maps, undistort = LensMaps(), inputs.on["lens_distortion"]
    masks = SharedMasks(inputs.source, images.mask_path)
    for row in progress(list(images.itertuples()), "pack_shards"):
        image = inputs.source.read(row.path, row.frame)
        camera, mask, silhouette = inputs.cameras[row.camera], None, None
        if isinstance(row.mask_path, str):
            mask = masks.read(row.mask_path, image.shape).astype(np.float32) / np.float32(MASK_LEVELS)
        else:
            silhouette = mesh_silhouette(inputs.vertices[row.frame], inputs.atlas.faces, camera)
        bad = int((~np.isfinite(image).all(2)).sum())
        if bad:
            log.warning("%s: %d pixels are not finite: black, and not subject", row.path, bad)
        crop = cut_crop(
            image,
            mask,
            camera,
            corrected_from_raw=inputs.colors.get(row.camera),
            undistort=undistort,
            silhouette=silhouette,
            margin_px=settings.margin_px,
            lens_map=maps.of(row.camera, camera) if undistort else None,
        )
        if crop is None:
            log.warning("%s: no foreground, left out", row.path)
            continue
        flags = {name: bool(getattr(row, name)) for name in (*TEST_FLAGS, VALIDATION)}
        box = {"x0": crop.box.x0, "y0": crop.box.y0, "width": crop.box.width, "height": crop.box.height}
        pinhole = {"K": crop.camera.K, "R": crop.camera.R, "t": crop.camera.t}
        fully_lit = bool(inputs.booked.fully_lit[row.frame])
        yield ImageRecord(
            row.camera, row.frame, **flags, fully_lit=fully_lit, **box, image=crop.image, mask=crop.mask, **pinhole
        )


def frame_record(frame: int, inputs: ChunkInputs) -> FrameRecord:
    """Geometry and light of a frame; its irradiance is 1 everywhere if no shadows were traced."""
    lit = inputs.patterns[inputs.patterns.frame == frame]
    irradiance = cosine_visibility = np.ones(inputs.atlas.texel_count, np.float32)
    if inputs.irradiance is not None:
        path = irradiance_file(inputs.irradiance, frame)
        irradiance, cosine_visibility = (
            inputs.atlas.from_map(read_exr_channel(path, name)) for name in ("Y", "falling")
        )
    row = inputs.booked.loc[frame]
    return FrameRecord(
        frame,
        str(row.segment),
        bool(row.fully_lit),
        vertices=inputs.vertices[frame].astype(np.float32),
        irradiance=irradiance.astype(np.float32),
        cosine_visibility=cosine_visibility.astype(np.float32),
        light_positions=lit[["x", "y", "z"]].to_numpy(np.float32),
        light_intensities=lit[["intensity_r", "intensity_g", "intensity_b"]].to_numpy(np.float32),
        head_from_world=inputs.heads.get(frame),
        gaze=inputs.gazes.get(frame),
        texture=inputs.textures.get(frame),
    )


def report_left_out(inputs: ChunkInputs) -> None:
    """Log the fisheyes of whose images a pinhole shows a part only."""
    if not inputs.on["lens_distortion"]:
        return
    for name, camera in inputs.cameras.items():
        if not camera.lens.perspective and (share := left_out(camera)) > 0:
            log.info("camera %s: %.0f %% of its image have no place in a pinhole's: left out", name, 100 * share)
