"""Pack a chunk of frames for training and evaluation.

Images become foreground crops, frames light and geometry.

Images lose their black level, get the colour of the average camera and the geometry of a pinhole (each only if
`plan_effects` found that it matters here) and are cut to the subject. Captures without masks get the silhouette of the
tracked mesh. Out: {train,validation,test}/CHUNK.arrow and frames/CHUNK.arrow, see `pipeline.capture.shards`. A variant
with irradiance maps of its own needs frames of its own, and the same images.
"""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np

from pipeline.base.command import run_as_command
from pipeline.base.files import read_arrays, read_json, read_rows, read_table
from pipeline.base.splits import TEST_FLAGS, VALIDATION
from pipeline.capture.chunk_records import (
    EFFECTS,
    ChunkInputs,
    crop_images,
    frame_record,
    report_left_out,
    require_inputs,
)
from pipeline.capture.head_data import head_motions, read_gaze, read_textures
from pipeline.capture.images import ImageSource
from pipeline.capture.shards import write_frame_shard, write_image_shards
from pipeline.config.pack_shards import PackShards
from pipeline.geometry.cameras import read_cameras
from pipeline.geometry.texels import read_atlas

log = logging.getLogger("pack_shards")


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
    inputs = ChunkInputs(
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
    require_inputs(inputs, images, effects)
    log.info("chunk %d: %d frames, %d images; on: %s", chunk, len(booked), len(images), [n for n in EFFECTS if on[n]])
    report_left_out(inputs)
    if not only_frames:
        paths = {split: out / split / f"{chunk:04d}.arrow" for split in ("train", VALIDATION, "test")}
        # In one pass: the frames of a video are decoded in their order, whatever their splits.
        crops = ((record.split, record) for record in crop_images(images, inputs, settings))
        for split, packed in write_image_shards(paths, crops, settings.codec).items():
            log.info("%s: %d images", split, packed)
    write_frame_shard(out / "frames" / f"{chunk:04d}.arrow", (frame_record(n, inputs) for n in booked.index.tolist()))


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
