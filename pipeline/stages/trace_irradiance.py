"""Trace normalised irradiance per frame: the share of light sent to a texel that arrives.

It reads a posed mesh and light patterns.

RFGCA 15-16 and A.1-A.3; see `pipeline.lighting.irradiance`. Every tracked frame that was booked gets an EXR (half
float, 0 outside the charts; channels Y, falling and error, the standard error of Y where lights were drawn), and a row
in a table that says what it took and what was saved. In a frame without a lit light the irradiance is 1. With an
environment map, it lights all frames instead of their patterns. Frames are computed on several threads; the result does
not depend on how many.
"""

from __future__ import annotations

import logging
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.command import run_as_command
from pipeline.base.errors import InputError
from pipeline.base.exr import write_exr
from pipeline.base.files import digest_file, read_table, write_table
from pipeline.base.progress import progress
from pipeline.base.seeds import generator_for
from pipeline.base.whole_files import written_folder
from pipeline.config.trace_irradiance import TraceIrradiance
from pipeline.figures.atlas_sheet import spread_tiles, write_atlas_sheet
from pipeline.geometry.texels import Atlas, read_atlas
from pipeline.geometry.tracked import TrackedChunk, read_tracked
from pipeline.lighting.environment import read_environment
from pipeline.lighting.frame_irradiance import FrameTracer, StageLights, environment_lights, read_stage_lights
from pipeline.lighting.irradiance import IrradianceMap

log = logging.getLogger("trace_irradiance")

DARK_BELOW = 0.5 / 255
"""Irradiance that would be shown as black in 8 bits: what the table counts as a dark texel."""


def run(
    *,
    atlas: Path,
    tracking: Path,
    lights: Path,
    patterns: Path,
    frames: Path,
    out: Path,
    environment: Path | None = None,
    cache: Path | None = None,
    subject: str = "",
    threads: int = 1,
    settings: TraceIrradiance = TraceIrradiance(),
) -> None:
    """Trace shadow rays from every texel of a chunk's posed meshes to the lit lights.

    So many arguments because a command line names each file that it reads.

    Args:
        atlas: atlas.safetensors of unwrap_atlas.
        tracking: one chunk of track_mesh.
        lights: calibration/lights.parquet.
        patterns: patterns.parquet of book_patterns.
        frames: frames.parquet of book_patterns; tracked frames that it lacks are left out.
        out: folder for the chunk's maps; the table is written beside it as OUT.parquet, a contact sheet as OUT.png.
        environment: panorama (.hdr or .exr) that lights all frames instead of the patterns.
        cache: folder for visibility bits, if they are kept; they are found again by their content.
        subject: the subject's name, part of the seed of the random draws.
        threads: frames traced at once.
        settings: numbers and modes.
    """
    texels = read_atlas(atlas)
    chunk = read_tracked(tracking, len(texels.rest_vertices))
    if environment is None:
        stage = read_stage_lights(lights, patterns)
    else:
        stage = environment_lights(read_environment(environment).reduced(settings.environment_height), chunk.frames)
    rows, tracer = booked_rows(chunk, frames, tracking), FrameTracer(texels, stage, settings, cache)

    def trace(row: int) -> IrradianceMap:
        random = generator_for(subject, "trace_irradiance", int(chunk.frames[row]))
        return tracer.trace(int(chunk.frames[row]), chunk.vertices[row], random)

    table, sheet = [], []
    shown = set(rows[spread_tiles(len(rows))])
    with written_folder(out, "trace_irradiance") as folder, ThreadPoolExecutor(threads) as pool:
        for row, traced in zip(rows, progress(pool.map(trace, rows.tolist()), "frames", len(rows)), strict=True):
            frame, path = int(chunk.frames[row]), folder / f"{int(chunk.frames[row]):06d}.exr"
            maps = {"Y": traced.values, "falling": traced.cosine_visibility, "error": traced.error}
            images = {name: texels.to_map(values) for name, values in maps.items()}
            write_exr(path, images)
            table.append({**describe(frame, traced, stage, texels), "digest": digest_file(path)})
            if row in shown:
                sheet.append((str(frame), traced.values[:, None]))
        write_atlas_sheet(out.with_name(f"{out.name}.png"), texels, sheet)
        write_table(out.with_name(f"{out.name}.parquet"), pd.DataFrame(table))
    report(pd.DataFrame(table))


def booked_rows(chunk: TrackedChunk, frames: Path, tracking: Path) -> np.ndarray:
    """Rows of the chunk that were booked.

    Raises:
        InputError: if there are none.
    """
    booked = np.isin(chunk.frames, read_table(frames).frame)
    if not booked.any():
        raise InputError(
            f"{tracking}: expected at least one frame that {frames} lists, found none; track the frames of this capture"
        )
    if not booked.all():
        log.info("left out, not in %s: frames %s", frames, chunk.frames[~booked].tolist())
    return np.flatnonzero(booked)


def describe(frame: int, traced: IrradianceMap, stage: StageLights, atlas: Atlas) -> dict[str, object]:
    """A row of the table: the map in numbers, and the rays traced and saved.

    Saved are rays of a renderer that asks for every pixel of the map and every light of the stage: outside the charts
    there is no surface, an unlit light sends nothing, one below its face's horizon is hidden, and the rest was either
    left to chance or known from visibility bits.
    """
    values, texels, lit = traced.values, len(traced.values), stage.lit_count(frame)
    asked, on_surface = atlas.size**2 * len(stage.places), texels * len(stage.places)
    return {
        "frame": frame, "lights_on": lit, "unlit": traced.unlit, "rays": traced.rays, "mean": values.mean(),
        "largest": values.max(), "texels": texels, "dark_texels": int((values < DARK_BELOW).sum()),
        "error_rms": float(np.sqrt(np.mean(traced.error**2))), "saved_outside_charts": asked - on_surface,
        "saved_unlit": on_surface - texels * lit, "saved_below_horizon": traced.below_horizon,
        # Bits of a pose may take more rays than its first pattern would have.
        "saved_drawn_or_known": max(texels * lit - traced.below_horizon - traced.rays, 0),
    }  # fmt: skip


def report(table: pd.DataFrame) -> None:
    """Log what was traced, and what was not."""
    rays, saved = table.rays.sum(), table.filter(like="saved_").sum()
    asked = max(rays + saved.sum(), 1)
    parts = ", ".join(f"{name.removeprefix('saved_')} {100 * count / asked:.1f} %" for name, count in saved.items())
    log.info("%d frames, %.3g rays, %d frames without a light", len(table), rays, table.unlit.sum())
    log.info("traced %.1f %% of all pixels x lights; saved: %s", 100 * rays / asked, parts.replace("_", " "))


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
