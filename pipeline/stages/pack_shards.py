"""Pack a chunk of frames for training and evaluation.

Images become foreground crops, frames light and geometry.

Images lose their black level, get the colour of the average camera and the geometry of a pinhole (each only if
`plan_effects` found that it matters here) and are cut to the subject. Captures without masks get the silhouette of the
tracked mesh. Out: {train,validation,test}/CHUNK.arrow and frames/CHUNK.arrow, see `pipeline.capture.shards`. A variant
with irradiance maps of its own needs frames of its own, and the same images.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.command import run_as_command
from pipeline.base.errors import Complaints
from pipeline.base.files import read_arrays, read_json, read_rows, read_table
from pipeline.base.progress import progress
from pipeline.base.splits import TEST_FLAGS, VALIDATION
from pipeline.capture.crops import cut_crop, mesh_silhouette
from pipeline.capture.head_data import head_motions, read_gaze, read_textures
from pipeline.capture.images import ImageSource, read_exr_channel
from pipeline.capture.records import FrameRecord, ImageRecord
from pipeline.capture.shards import MASK_LEVELS, write_frame_shard, write_image_shards
from pipeline.capture.shared_masks import SharedMasks
from pipeline.capture.undistortion import LensMaps, left_out
from pipeline.config.pack_shards import PackShards
from pipeline.geometry.cameras import read_cameras
from pipeline.geometry.texels import read_atlas

log = logging.getLogger("pack_shards")

EFFECTS = ("color_correction", "lens_distortion")


def run(
    *,
    capture: Path,
    index: Path,
    atlas: Path,
    tracking: Path,
    cameras: Path,
    color: Path,
    effects: Path,
    patterns: Path,
    frames: Path,
    lights: Path,
    out: Path,
    irradiance: Path | None = None,
    textures: Path | None = None,
    estimated_gaze: Path | None = None,
    chunk: int = 0,
    chunk_size: int = 64,
    only_frames: bool = False,
    settings: PackShards = PackShards(),
) -> None:
    """Pack the images and frames of one chunk.

    So many arguments because a command line names each file that it reads.

    Args:
        capture: folder of the capture, for its images and masks.
        index: folder of index_capture.
        atlas: atlas.safetensors of unwrap_atlas.
        tracking: tracking/CHUNK.safetensors of track_mesh.
        cameras: cameras.json in the stage frame, sensor resolution.
        color: color.json of calibrate_color.
        effects: effects.json of plan_effects.
        patterns: patterns.parquet of book_patterns.
        frames: frames.parquet of book_patterns; only its frames are packed.
        lights: lights.parquet of calibrate_lights.
        out: folder of the shards.
        irradiance: irradiance/CHUNK of trace_irradiance; not given, nothing is in shadow.
        textures: textures/CHUNK.safetensors of bake_textures; not given, frames have no mean texture.
        estimated_gaze: gaze.parquet of estimate_gaze, where the capture declares none.
        chunk: which chunk; chunk c holds the sorted frames from c * chunk_size.
        chunk_size: frames per chunk.
        only_frames: write frames/CHUNK.arrow alone.
        settings: see the flags below.
    """
    on = {name: bool(effect["on"]) for name, effect in read_json(effects).items()}
    described = read_json(index / "capture.json")
    facts = described["images"]
    numbers = np.sort(read_table(index / "frames.parquet").frame.to_numpy())[
        chunk * chunk_size : (chunk + 1) * chunk_size
    ]
    booked = read_table(frames).set_index("frame")
    booked = booked[booked.index.isin(numbers)].sort_index()
    images = read_rows(index / "images.parquet", "frame", booked.index).sort_values(["frame", "camera"])
    # The index knows the frames that the capture lists; book_patterns, all others that show the same pattern.
    images["test_pattern"] = images.frame.map(booked.test_pattern).astype(bool)
    test = images[list(TEST_FLAGS)].any(axis=1)
    chosen = images.validation_camera | images.frame.map(booked.validation).astype(bool)
    images[VALIDATION] = chosen & ~test
    tracked = read_arrays(tracking)
    inputs = Inputs(
        source=ImageSource.from_index(capture, facts),
        on=on,
        booked=booked,
        vertices=dict(zip(tracked["frames"].tolist(), tracked["vertices"], strict=True)),
        cameras={n: c.downsampled(float(facts["downsample_from_sensor"])) for n, c in read_cameras(cameras).items()},
        colors={n: np.array(m) for n, m in read_json(color)["cameras"].items()} if on.get("color_correction") else {},
        atlas=read_atlas(atlas),
        patterns=read_rows(patterns, "frame", booked.index).merge(
            read_table(lights)[["light", "x", "y", "z"]], on="light", how="left"
        ),
        irradiance=irradiance,
        heads=head_motions(tracked) if described["kind"] == "head" else {},
        gazes=read_gaze(estimated_gaze or index / "gaze.parquet"),
        textures=read_textures(textures) if textures else {},
    )
    complain_about(inputs, images, effects)
    log.info("chunk %d: %d frames, %d images; on: %s", chunk, len(booked), len(images), [n for n in EFFECTS if on[n]])
    report_left_out(inputs)
    if not only_frames:
        paths = {split: out / split / f"{chunk:04d}.arrow" for split in ("train", VALIDATION, "test")}
        # In one pass: the frames of a video are decoded in their order, whatever their splits.
        crops = ((record.split, record) for record in crop_images(images, inputs, settings))
        for split, packed in write_image_shards(paths, crops, settings.codec).items():
            log.info("%s: %d images", split, packed)
    write_frame_shard(out / "frames" / f"{chunk:04d}.arrow", (frame_record(n, inputs) for n in booked.index.tolist()))


def report_left_out(inputs: Inputs) -> None:
    """Log the fisheyes of whose images a pinhole shows a part only."""
    if not inputs.on["lens_distortion"]:
        return
    for name, camera in inputs.cameras.items():
        if not camera.lens.perspective and (share := left_out(camera)) > 0:
            log.info("camera %s: %.0f %% of its image have no place in a pinhole's: left out", name, 100 * share)


@dataclass(frozen=True)
class Inputs:
    """Everything read before the images.

    `patterns` are those of the chunk, with the positions of their lights. `heads`, `gazes` and `textures` are by frame,
    as in `FrameRecord`; empty if there are none.
    """

    source: ImageSource
    on: dict[str, bool]
    booked: pd.DataFrame
    vertices: dict[int, np.ndarray]
    cameras: dict
    colors: dict[str, np.ndarray]
    atlas: object
    patterns: pd.DataFrame
    irradiance: Path | None
    heads: dict[int, np.ndarray]
    gazes: dict[int, np.ndarray]
    textures: dict[int, np.ndarray]


def complain_about(inputs: Inputs, images: pd.DataFrame, effects: Path) -> None:
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


def crop_images(images: pd.DataFrame, inputs: Inputs, settings: PackShards) -> Iterator[ImageRecord]:
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


def frame_record(frame: int, inputs: Inputs) -> FrameRecord:
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


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
