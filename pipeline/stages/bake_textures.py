"""Bake mean textures of a chunk of frames.

They are what the cameras saw of each texel when all lights were on.

Images of training cameras in fully lit frames are looked up at the tracked mesh's texels and averaged, weighted by
visibility and the cosine of the view. Other frames lie between fully lit ones and get what lies between their textures;
without any fully lit frame, all frames of the chunk count as such and share their mean. Out: CHUNK.safetensors (frames,
textures: float16, linear RGB) and CHUNK.png, a contact sheet. Heads are encoded from vertices and this.
"""

from __future__ import annotations

import logging
from collections.abc import Collection
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.color import srgb_from_linear
from pipeline.base.command import run_as_command
from pipeline.base.errors import Complaints, InputError
from pipeline.base.files import read_json, read_rows, read_table
from pipeline.base.progress import progress
from pipeline.capture.head_data import write_textures
from pipeline.capture.images import ImageSource
from pipeline.config.bake_textures import BakeTextures
from pipeline.effects.mean_textures import SeenColors, between_lit_frames, fill_unseen, joined, seen_colors
from pipeline.effects.scene_evidence import read_colors
from pipeline.figures.atlas_sheet import spread_tiles, write_atlas_sheet
from pipeline.geometry.cameras import read_cameras
from pipeline.geometry.texels import read_atlas, texel_frames
from pipeline.geometry.tracked import TrackedChunk, read_tracked

log = logging.getLogger("bake_textures")


def run(
    *, capture: Path, index: Path, atlas: Path, tracking: Path, cameras: Path, color: Path, effects: Path,
    frames: Path, out: Path, settings: BakeTextures = BakeTextures(),
) -> None:  # fmt: skip
    """Average what fully lit frames of a chunk show of each texel.

    So many arguments because a command line names each file that it reads.

    Args:
        capture: folder of the capture, for its images.
        index: folder of index_capture.
        atlas: atlas.safetensors of unwrap_atlas.
        tracking: tracking/CHUNK.safetensors of track_mesh.
        cameras: cameras.json in the stage frame, sensor resolution.
        color: color.json of calibrate_color.
        effects: effects.json of plan_effects, which says whether colours are corrected.
        frames: frames.parquet of book_patterns; only its frames get a texture.
        out: textures/CHUNK; written are OUT.safetensors and a contact sheet, OUT.png.
        settings: numbers.
    """
    texels = read_atlas(atlas)
    chunk = read_tracked(tracking, len(texels.rest_vertices))
    booked = booked_frames(chunk, frames, tracking)
    posed = dict(zip(chunk.frames.tolist(), chunk.vertices, strict=True))
    facts = read_json(index / "capture.json")["images"]
    source = ImageSource.from_index(capture, facts)
    calibrated = {n: c.downsampled(float(facts["downsample_from_sensor"])) for n, c in read_cameras(cameras).items()}
    corrected = read_json(effects).get("color_correction", {}).get("on", False)
    colors = read_colors(color) if corrected else {}
    lit = booked.fully_lit.to_numpy(bool)
    shown = booked.frame[lit | ~lit.any()].tolist()
    images = training_images(index, shown, calibrated, cameras)
    found = [
        seen_colors(
            source, images[images.frame == frame], calibrated, colors, texels, posed[frame], settings.cosine_power
        )
        for frame in progress(shown, "frames")
    ]  # fmt: skip
    report(shown, found)
    if not lit.any():
        log.warning("no fully lit frame: all %d frames share one mean texture", len(booked))
        found, shown = [joined(found)], shown[:1]
    points, _ = texel_frames(texels, texels.rest_vertices.astype(np.float64))
    filled = fill_unseen(found, points)
    takes = pd.factorize(booked.segment)[0].astype(np.int64)
    textures = between_lit_frames(filled, lit, takes) if lit.any() else np.repeat(filled, len(lit), axis=0)
    write_textures(out.with_name(f"{out.name}.safetensors"), booked.frame.to_numpy(), textures)
    tiles = [(str(shown[i]), srgb_from_linear(filled[i].clip(0, 1))) for i in spread_tiles(len(filled))]
    write_atlas_sheet(out.with_name(f"{out.name}.png"), texels, tiles)


def booked_frames(chunk: TrackedChunk, frames: Path, tracking: Path) -> pd.DataFrame:
    """frame, segment and fully_lit of the chunk's frames that were booked, in order.

    Raises:
        InputError: if there are none.
    """
    booked = read_table(frames)
    booked = booked[booked.frame.isin(chunk.frames)].sort_values("frame", ignore_index=True)
    if booked.empty:
        raise InputError(
            f"{tracking}: expected at least one frame that {frames} lists, found none; track the frames of this capture"
        )
    return booked


def training_images(index: Path, shown: list[int], calibrated: Collection[str], cameras: Path) -> pd.DataFrame:
    """Images of some frames by cameras that are not held out.

    What is learned from may show nothing of the held-out ones.

    Raises:
        InputError: if a camera is not calibrated, or there is no such image.
    """
    path, complaints = index / "images.parquet", Complaints("bake_textures")
    images = read_rows(path, "frame", shown)
    images = images[~images.test_camera.astype(bool)].sort_values(["frame", "camera"])
    if images.empty:
        complaints.add(path, "camera", expected="images of fully lit frames by training cameras", found="none")
    for camera in sorted(set(images.camera) - set(calibrated)):
        complaints.add(cameras, camera, expected="a calibrated camera, as it has images", found="none")
    complaints.raise_if_any()
    return images


def report(shown: list[int], found: list[SeenColors]) -> None:
    """Log how much is seen, and what never is."""
    seen = np.stack([colors.weight > 0 for colors in found])
    log.info("%d frames looked at; of the texels, cameras see %.0f %% in one", len(shown), 100 * seen.mean())
    if never := int((~seen.any(0)).sum()):
        log.info("%d of %d texels are seen in no frame and get the colour of their neighbours", never, seen.shape[1])


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
