"""Make a native capture of a procedural subject, and the truth beside it.

It is complete (lightstage-capture/1).

A skinned figure or an unrigged head moves in a dome of lights; Mitsuba path-traces it from a ring of cameras with lens
distortion, colour responses and noise, together with every calibration image the format asks for. `<out>/truth` holds
what the other stages have to recover; none of them reads it. Truth is independent of the pipeline: the images come from
Mitsuba, the posed vertices from this package's own skinning or displacement.
"""

from __future__ import annotations

import logging
import multiprocessing
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pandas as pd

from pipeline.base.command import run_as_command
from pipeline.base.errors import Complaints
from pipeline.base.parent_death import end_with_parent
from pipeline.base.progress import progress
from pipeline.base.whole_files import written_folder
from pipeline.config.synthesize_capture import SynthesizeCapture
from pipeline.synthesis.capture_files import write_capture_yaml, write_gaze, write_renderer, write_tables, write_truth
from pipeline.synthesis.figure import build_figure
from pipeline.synthesis.head import build_head
from pipeline.synthesis.photography import FrameJob, Job, all_jobs, take
from pipeline.synthesis.renderer_choice import choose_renderer
from pipeline.synthesis.stage_rig import build_stage_rig, light_patterns, segment_for
from pipeline.synthesis.studio import Studio
from pipeline.synthesis.subject import Subject

log = logging.getLogger("synthesize_capture")


def run(*, subject: str, out: Path, workers: int = 2, settings: SynthesizeCapture = SynthesizeCapture()) -> None:
    """Synthesize the capture of a procedural subject in a light stage.

    Args:
        subject: name of the subject; seeds everything random.
        out: folder of the capture, replaced as a whole if this stage made it; anything else there is refused.
        workers: processes that render; the result does not depend on it.
        settings: the subject, the stage and the pictures.
    """
    check_settings(subject, settings)
    shown = build_subject(subject, settings)
    rig = build_stage_rig(subject, settings)
    patterns = light_patterns(subject, rig, settings)
    intensities = patterns.pivot(index="frame", columns="light", values="intensity").fillna(0.0)
    intensities = intensities.reindex(columns=list(rig.light_positions), fill_value=0.0)
    moments = []
    for frame in range(settings.frames):
        segment, time_s = segment_for(frame, settings)
        moments.append(shown.at(time_s, segment))
    log.info("%d vertices, %d cameras, %d lights", len(shown.vertices), len(rig.cameras), len(rig.light_positions))
    renderer, llvm_version = choose_renderer(settings)
    log.info("renderer: %s", f"llvm {llvm_version}" if llvm_version else renderer)
    with written_folder(out, "synthesize_capture") as root:
        studio = Studio(root.resolve(), subject, settings, rig, renderer)
        frames = [
            FrameJob(studio, shown, frame, moment, intensities.loc[frame].to_numpy())
            for frame, moment in enumerate(moments)
        ]
        jobs = all_jobs(studio, frames)
        found = list(progress(_taken(jobs, workers), "photographs", total=len(jobs)))
        keypoints = pd.concat([table for table in found if table is not None], ignore_index=True)
        write_tables(root, subject, rig, patterns, keypoints, settings)
        shown.write_template(root / "template", settings)
        write_truth(root, rig, shown, moments, settings.uvs)
        write_renderer(root, renderer, llvm_version)
        if shown.eyes:
            write_gaze(root, moments)
        write_capture_yaml(root, subject, shown, rig, settings)


def build_subject(subject: str, settings: SynthesizeCapture) -> Subject:
    """The figure or head that is captured."""
    common = (subject, settings.vertex_spacing_m, settings.texture_size, settings.gloss_alpha)
    if settings.figure == "head":
        return build_head(*common, settings.cornea_alpha, settings.hair_strands)
    return build_figure(*common)


def _taken(jobs: list[Job], workers: int) -> Iterator[pd.DataFrame | None]:
    """Results in the order of the jobs, whatever the number of workers."""
    if workers <= 1:
        yield from map(take, jobs)
        return
    # A forked child of a process with thread pools may hang: spawn.
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), end_with_parent) as pool:
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
    rest = len(partial) - settings.test_frames
    demand("test_patterns", settings.test_patterns, max(rest, 0), "what test_frames leaves of them")
    demand("ball_cameras", settings.ball_cameras, settings.cameras, "the number of cameras")
    if settings.figure == "body":
        demand("hair_strands", settings.hair_strands, 0, "as only heads have strands of hair")
    if settings.board_marker_m >= settings.board_square_m:
        found = str(settings.board_marker_m)
        complaints.add("settings", "board_marker_m", expected="less than board_square_m", found=found)
    complaints.raise_if_any()


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
