"""Posed mesh and light patterns -> normalised irradiance per frame: how much of the light sent to a texel arrives.

RFGCA 15-16 and A.1-A.3; see `pipeline.lighting.irradiance`. Every tracked frame that was booked gets an EXR (half
float, channel Y, 0 outside the charts), and a row in a table. In a frame without a lit light the irradiance is 1.
Frames are computed on several threads; the result does not depend on how many.
"""

from __future__ import annotations

import logging
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import pandas as pd

from pipeline.base.command import run_as_command
from pipeline.base.errors import InputError
from pipeline.base.files import digest_file, read_table, write_table, written_whole
from pipeline.base.progress import progress
from pipeline.base.seeds import generator_for
from pipeline.capture.images import write_exr
from pipeline.config.trace_irradiance import TraceIrradiance
from pipeline.geometry.mesh import area_vectors, unit_or
from pipeline.geometry.texels import Atlas, read_atlas, texel_frames
from pipeline.geometry.tracked import read_tracked
from pipeline.lighting.frame_lights import NO_LIGHTS, FrameLights, read_frame_lights
from pipeline.lighting.irradiance import LUMINANCE, IrradianceMap, trace_irradiance
from pipeline.lighting.visibility import Occluders

log = logging.getLogger("trace_irradiance")

DARK_BELOW = 0.5 / 255
"""Irradiance that would be shown as black in 8 bits: what the table counts as a dark texel."""

SHEET_FRAMES = 12
"""Maps on the contact sheet, evenly spaced over the chunk."""


def run(
    *,
    atlas: Path,
    tracking: Path,
    lights: Path,
    patterns: Path,
    frames: Path,
    out: Path,
    subject: str = "",
    threads: int = 1,
    settings: TraceIrradiance = TraceIrradiance(),
) -> None:
    """Trace shadow rays from every texel of a chunk's posed meshes to the lit lights.

    Args:
        atlas: atlas.safetensors of unwrap_atlas.
        tracking: one chunk of track_mesh.
        lights: calibration/lights.parquet.
        patterns: patterns.parquet of book_patterns.
        frames: frames.parquet of book_patterns; tracked frames that it lacks are left out.
        out: folder for the chunk's maps; the table is written beside it as OUT.parquet, a contact sheet as OUT.png.
        subject: the subject's name, part of the seed of the random draws.
        threads: frames traced at once.
        settings: numbers and modes.
    """
    texels = read_atlas(atlas)
    chunk = read_tracked(tracking, len(texels.rest_vertices))
    lit = read_frame_lights(lights, patterns)
    booked = np.isin(chunk.frames, read_table(frames).frame)
    if not booked.any():
        raise InputError(
            f"{tracking}: expected at least one frame that {frames} lists, found none; track the frames of this capture"
        )
    if not booked.all():
        log.info("left out, not in %s: frames %s", frames, chunk.frames[~booked].tolist())

    def trace(row: int) -> IrradianceMap:
        frame = int(chunk.frames[row])
        random = generator_for(subject, "trace_irradiance", frame)
        return trace_frame(texels, chunk.vertices[row], lit.get(frame, NO_LIGHTS), settings, random)

    rows, sheet = np.flatnonzero(booked), []
    shown = set(rows[np.linspace(0, len(rows) - 1, min(SHEET_FRAMES, len(rows))).astype(int)])
    table = []
    with written_whole(out) as folder, ThreadPoolExecutor(threads) as pool:
        folder.mkdir()
        for row, traced in zip(rows, progress(pool.map(trace, rows.tolist()), "frames", len(rows)), strict=True):
            frame = int(chunk.frames[row])
            image = texels.to_map(traced.values)
            write_exr(folder / f"{frame:06d}.exr", {"Y": image, "falling": texels.to_map(traced.falling)})
            row_of_table = _describe(frame, traced, len(lit.get(frame, NO_LIGHTS).positions))
            table.append({**row_of_table, "digest": digest_file(folder / f"{frame:06d}.exr")})
            if row in shown:
                sheet.append((frame, image))
        _write_sheet(out.with_name(f"{out.name}.png"), texels, sheet)
        write_table(out.with_name(f"{out.name}.parquet"), pd.DataFrame(table))
    unlit = sum(row["unlit"] for row in table)
    log.info("%d frames, %.3g rays, %d frames without a light", len(table), sum(r["rays"] for r in table), unlit)


def trace_frame(
    atlas: Atlas, vertices: np.ndarray, lit: FrameLights, settings: TraceIrradiance, random: np.random.Generator
) -> IrradianceMap:
    """Irradiance per texel of one frame."""
    posed = vertices.astype(np.float64)
    points, frames = texel_frames(atlas, posed)
    # A degenerate face has no horizon: a normal of zero leaves its texels dark, without rays.
    normals = unit_or(area_vectors(posed, atlas.faces), 0.0)[atlas.face]
    return trace_irradiance(
        Occluders(posed, atlas.faces), points, normals, lit.positions, lit.intensities @ LUMINANCE,
        normals=frames[..., 2], samples=settings.samples_or_none, sampling=settings.sampling, random=random,
    )  # fmt: skip


def _describe(frame: int, traced: IrradianceMap, lights_on: int) -> dict[str, object]:
    values = traced.values
    return {
        "frame": frame, "lights_on": lights_on, "unlit": traced.unlit, "rays": traced.rays, "mean": values.mean(),
        "largest": values.max(), "texels": len(values), "dark_texels": int((values < DARK_BELOW).sum()),
    }  # fmt: skip


def _write_sheet(path: Path, atlas: Atlas, maps: list[tuple[int, np.ndarray]]) -> None:
    """A contact sheet: irradiance 0..1 as grey, the atlas's background in blue, the frame's number above each map."""
    outside = atlas.to_map(np.zeros(atlas.texel_count), 1.0) > 0
    tiles = []
    for frame, image in maps:
        grey = np.clip(image * 255, 0, 255).astype(np.uint8)
        tile = np.where(outside[..., None], np.array([96, 48, 16], np.uint8), grey[..., None])
        tile = cv2.copyMakeBorder(tile, 18, 2, 2, 2, cv2.BORDER_CONSTANT, value=(255, 255, 255))
        tiles.append(cv2.putText(tile, str(frame), (4, 13), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (0, 0, 0), 1, cv2.LINE_AA))
    across = int(np.ceil(np.sqrt(len(tiles))))
    tiles += [np.full_like(tiles[0], 255)] * (-len(tiles) % across)
    sheet = cv2.vconcat([cv2.hconcat(tiles[i : i + across]) for i in range(0, len(tiles), across)])
    with written_whole(path) as temporary:
        temporary.write_bytes(cv2.imencode(".png", sheet)[1].tobytes())


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
