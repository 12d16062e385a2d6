"""Make a complete native capture (lightstage-capture/1) of a procedural figure, and the truth beside it.

A skinned figure moves in a dome of lights; Mitsuba path-traces it from a ring of cameras with lens distortion, colour
responses and noise, together with every calibration image the format asks for. `<out>/truth` holds what the other
stages have to recover; none of them reads it. Truth is independent of the pipeline: the images come from Mitsuba, the
posed vertices from this package's own skinning.
"""

from __future__ import annotations

import logging
import multiprocessing
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.command import run_as_command
from pipeline.base.errors import Complaints
from pipeline.base.files import written_whole
from pipeline.base.progress import progress
from pipeline.config.synthesize_capture import SynthesizeCapture
from pipeline.synthesis.capture_files import (
    template_source,
    write_capture_yaml,
    write_tables,
    write_template,
    write_truth,
)  # fmt: skip
from pipeline.synthesis.figure import build_figure
from pipeline.synthesis.motion import pose_at
from pipeline.synthesis.photography import FrameJob, Job, Studio, all_jobs, take
from pipeline.synthesis.stage_rig import build_stage_rig, light_patterns, segment_of

FLOOR_Y_M = -0.88
"""Height of the ground in the stage frame: puts the figure's middle at the stage's centre."""

log = logging.getLogger("synthesize_capture")


def run(*, subject: str, out: Path, workers: int = 2, settings: SynthesizeCapture = SynthesizeCapture()) -> None:
    """Synthesize the capture of a procedural figure in a light stage.

    Args:
        subject: name of the subject; seeds everything random.
        out: folder of the capture, replaced as a whole.
        workers: processes that render; the result does not depend on it.
        settings: the figure, the stage and the pictures.
    """
    check_settings(subject, settings)
    figure = build_figure(subject, settings.vertex_spacing_m, settings.texture_size)
    rig = build_stage_rig(subject, settings)
    patterns = light_patterns(subject, rig, settings)
    intensities = patterns.pivot(index="frame", columns="light", values="intensity").fillna(0.0)
    intensities = intensities.reindex(columns=list(rig.light_positions), fill_value=0.0)
    poses, posed = [], []
    for frame in range(settings.frames):
        segment, time_s = segment_of(frame, settings)
        poses.append(pose_at(figure.skeleton, time_s, segment, FLOOR_Y_M))
        posed.append(figure.posed(poses[-1].rotations, poses[-1].root_translation))
    log.info("%d vertices, %d cameras, %d lights", len(figure.vertices), len(rig.cameras), len(rig.light_positions))
    with written_whole(out) as root:
        studio = Studio(root.resolve(), subject, settings, rig)
        frames = [
            FrameJob(studio, figure, frame, vertices, joints, intensities.loc[frame].to_numpy())
            for frame, (vertices, joints) in enumerate(posed)
        ]
        jobs = all_jobs(studio, frames)
        found = list(progress(_taken(jobs, workers), "photographs", total=len(jobs)))
        keypoints = pd.concat([table for table in found if table is not None], ignore_index=True)
        write_tables(root, subject, rig, patterns, keypoints, settings)
        write_template(root, figure, settings)
        source = template_source(figure, settings)
        vertices = np.stack([frame_vertices[source] for frame_vertices, _ in posed])
        write_truth(root, rig, vertices, np.stack([joints for _, joints in posed]), poses)
        write_capture_yaml(root, subject, rig, settings)


def _taken(jobs: list[Job], workers: int) -> Iterator[pd.DataFrame | None]:
    """Results in the order of the jobs, whatever the number of workers."""
    if workers <= 1:
        yield from map(take, jobs)
        return
    # A forked child of a process with thread pools may hang: spawn.
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        yield from pool.map(take, jobs)


def check_settings(subject: str, settings: SynthesizeCapture) -> None:
    """Check what single fields cannot.

    Raises:
        InputError: naming every combination that cannot be made.
    """
    complaints = Complaints(f"synthesize_capture settings of {subject}")

    def demand(key: str, value: int, most: int, why: str) -> None:
        if value > most:
            complaints.add("settings", key, expected=f"at most {most}, {why}", found=str(value))

    partial = [f for f in range(settings.frames - settings.frames_b) if f % settings.fully_lit_every != 0]
    demand("frames_b", settings.frames_b, settings.frames - 1, "to leave a frame for segment a")
    demand("partial_lights_max", settings.partial_lights_max, settings.lights, "the number of lights")
    demand("partial_lights_min", settings.partial_lights_min, settings.partial_lights_max, "partial_lights_max")
    demand("test_cameras", settings.test_cameras, settings.cameras - 1, "to leave a camera for training")
    demand("test_frames", settings.test_frames, len(partial), "the partially lit frames of segment a")
    demand("ball_cameras", settings.ball_cameras, settings.cameras, "the number of cameras")
    if settings.board_marker_m >= settings.board_square_m:
        found = str(settings.board_marker_m)
        complaints.add("settings", "board_marker_m", expected="less than board_square_m", found=found)
    complaints.raise_if_any()


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
