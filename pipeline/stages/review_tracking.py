"""Draw what a person judges the tracking by.

It writes verdicts, the template over the images, errors over time, and a recording.

Nothing here changes the tracking. `index.html` has the pictures; `tracking.rrd` has the capture to scrub through, with
the viewer of rerun-sdk: `python -m rerun tracking.rrd`.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from pathlib import Path

import numpy as np

from pipeline.base.command import run_as_command
from pipeline.base.files import write_table
from pipeline.base.spread import evenly
from pipeline.base.verdicts import Verdict, log_verdicts, verdict_table
from pipeline.base.whole_files import written_folder
from pipeline.config.review_tracking import ReviewTracking
from pipeline.figures.page import Section, write_page
from pipeline.figures.style import worst
from pipeline.figures.surface_lines import level_lines
from pipeline.figures.tracked_capture import TrackedCapture, read_tracked_capture
from pipeline.figures.tracking_plot import draw_errors
from pipeline.figures.tracking_sheet import draw_sheet, read_panel
from pipeline.figures.tracking_verdicts import camera_verdicts, frame_verdicts
from pipeline.geometry.surface_points import SurfacePoints

log = logging.getLogger("review_tracking")


def run(
    *, capture: Path, index: Path, calibration: Path, tracking: tuple[Path, ...], patterns: Path, out: Path,
    threads: int = 1, settings: ReviewTracking = ReviewTracking(),
) -> None:  # fmt: skip
    """Gather what the tracking of all frames is worth, and draw it.

    Args:
        capture: folder of the capture.
        index: folder that index_capture wrote.
        calibration: folder that the calibrating stages wrote.
        tracking: what track_mesh wrote of every chunk, in order: {chunk}.safetensors, with {chunk}.parquet beside it.
        patterns: patterns.parquet of book_patterns.
        out: folder to write: index.html, its pictures, verdicts.csv and, if wanted, tracking.rrd.
        threads: images read at a time.
    """
    found = read_tracked_capture(capture, index, calibration, tracking, patterns)
    frames, cameras = frame_verdicts(found), camera_verdicts(found)
    log_verdicts(log, [*cameras, *frames])
    lines = level_lines(found.template.vertices_rest, found.template.faces)
    with ThreadPoolExecutor(threads) as pool, written_folder(out, "review_tracking") as folder:
        draw_errors(folder / "errors.png", found, [verdict.grade for verdict in frames])
        sections = [
            Section("Error per frame", "errors.png", "Does every frame fit as well as the others?"),
            show_worst(folder, found, lines, frames, settings, pool),
            *show_cameras(folder, found, lines, frames, cameras, settings, pool),
        ]
        if settings.recording:
            from pipeline.figures.recording import write_recording  # rerun, for those who want a recording.

            write_recording(folder / "tracking.rrd", found, settings, pool)
            text = "The capture to scrub through, in a viewer: python -m rerun tracking.rrd"
            sections.insert(0, Section("Recording", "", text))
        write_page(folder / "index.html", f"Tracking of {found.subject}", [*cameras, *frames], sections)
        write_table(folder / "verdicts.csv", verdict_table([*cameras, *frames]))


def show_worst(
    folder: Path, found: TrackedCapture, lines: SurfacePoints, frames: Sequence[Verdict], settings: ReviewTracking,
    pool: Executor,
) -> Section:  # fmt: skip
    """worst.png: the frames that fit worst, each in the camera where its keypoints do."""
    grades = {str(row): verdict.grade for row, verdict in enumerate(frames)}
    errors = np.nan_to_num(found.frames.rms_px.to_numpy(np.float64), nan=np.inf)
    rows = worst({str(row): float(error) for row, error in enumerate(errors)}, grades, settings.sheet_frames)
    # Not the largest: that is a wrong detection.
    typical = np.array([[_typical(frame) for frame in camera] for camera in found.residual_px])
    names = [list(found.cameras)[int(typical[:, int(row)].argmax())] for row in rows]
    panels = list(pool.map(lambda name, row: read_panel(found, lines, name, int(row)), names, rows))
    panels.sort(key=lambda panel: panel.row)
    draw_sheet(folder / "worst.png", "The worst frames", found, panels, frames, settings.outlier_px, named=True)
    return Section("The worst frames", "worst.png", "If the template fits here, it fits everywhere.")


def _typical(residual: np.ndarray) -> float:
    return float(np.nanmedian(residual)) if np.isfinite(residual).any() else -1.0


def show_cameras(
    folder: Path, found: TrackedCapture, lines: SurfacePoints, frames: Sequence[Verdict],
    cameras: Sequence[Verdict], settings: ReviewTracking, pool: Executor,
) -> list[Section]:  # fmt: skip
    """One sheet per camera: some evenly chosen, and all that are not good."""
    amiss = [verdict.name for verdict in cameras if verdict.grade != "good"][: settings.most_cameras]
    others = [name for name in found.cameras if name not in amiss]
    shown = sorted([*amiss, *evenly(others, settings.most_cameras - len(amiss))])
    rows = evenly(range(len(found.frames)), settings.sheet_frames)
    sections = []
    for name in shown:
        panels = list(pool.map(lambda row, name=name: read_panel(found, lines, name, row), rows))
        role = " (held out: took no part in tracking)" if name in found.held_out else ""
        title = f"{name}{role}"
        file = f"camera_{name}.png"
        draw_sheet(folder / file, title, found, panels, frames, settings.outlier_px)
        sections.append(Section(title, file, f"{len(rows)} of {len(found.frames)} frames, evenly chosen."))
    return sections


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
