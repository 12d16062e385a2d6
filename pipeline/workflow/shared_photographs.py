"""Jobs that share the photographs of a large capture's calibration.

They find boards, or measure lights, of which a job has those of whole cameras. Each handles about `chunk_images`
photographs at least, and is numbered. The stage that one job runs for a small capture joins their tables for a large
one.
"""

from __future__ import annotations

import functools
import json
import os
from dataclasses import replace
from pathlib import Path

from pipeline.budget.job_size import JobSize
from pipeline.config.calibrate_cameras import BOARD_METHODS
from pipeline.config.subjects import read_description
from pipeline.workflow.job_files import JobFiles
from pipeline.workflow.job_size import job_size

FOUND, MEASURED = "found_boards/{share}.parquet", "measured_lights/{share}.parquet"
"""Tables of these jobs below the subject's results."""

MOST_SHARES = 9999
"""Numbers of four digits."""

FITTED_VIEWS = 10
"""Images of boards of each camera in the runs that job_costs.csv was fitted to: a share of so many costs a camera."""


def found_boards(files: JobFiles, calibration: str | Path) -> list[str]:
    """Tables of boards that are found in some of the photographs.

    None if one job finds them all.

    Args:
        calibration: calibration_cameras.json of index_capture.
    """
    return _tables(files, FOUND, board_photographs(files, calibration) // files.settings.chunk_images)


def board_photographs(files: JobFiles, calibration: str | Path) -> int:
    """Number of photographs in which calibrate_cameras looks for boards.

    0 of a capture that is not indexed yet.
    """
    shots, images, timed = _counted_views(Path(calibration), _changed(calibration))
    most = files.settings.calibrate_cameras.most_views
    # Where a moving board rests shows once it is found in all of them.
    return images if timed or most is None or most >= shots else images * most // shots


def measured_lights(files: JobFiles) -> list[str]:
    """Tables of what is measured in photographs of mirror balls; none if one job does it all.

    An imported capture has none, or few.
    """
    size = job_size(replace(files, chunk=None, variant=None))
    shares = min(size.cameras, size.cameras * size.lights // files.settings.chunk_images)
    tables = _tables(files, MEASURED, shares)
    return tables if tables and _has_balls(files) else []


def boards_share_size(files: JobFiles, calibration: str | Path) -> JobSize:
    """Size of a job that looks for boards in some of the photographs.

    It is that of as many cameras as usually take so many.
    """
    size, shares = job_size(files), found_boards(files, calibration)
    if not shares:
        return size
    images = -(-board_photographs(files, calibration) // len(shares))
    return replace(size, cameras=-(-images // FITTED_VIEWS))


def boards_joined_size(files: JobFiles, calibration: str | Path) -> JobSize:
    """Size of the job that calibrates cameras: by others' tables without an image of its own."""
    size = job_size(files)
    return replace(size, pixels=0) if found_boards(files, calibration) else size


def lights_share_size(files: JobFiles) -> JobSize:
    """Size of a job that measures photographs of some cameras."""
    size = job_size(files)
    return replace(size, cameras=-(-size.cameras // max(1, len(measured_lights(files)))))


def lights_joined_size(files: JobFiles) -> JobSize:
    """Size of the job that fits lights: to others' tables without an image of its own."""
    size = job_size(files)
    return replace(size, pixels=0) if measured_lights(files) else size


def size_of_calibration(stage: str, files: JobFiles) -> JobSize:
    """Size of a stage's only job, which reads photographs unless others do."""
    if stage == "calibrate_cameras":
        return boards_joined_size(files, board_index(files))
    return lights_joined_size(files) if stage == "calibrate_lights" else job_size(files)


def board_index(files: JobFiles) -> str:
    """calibration_cameras.json of the index, where all is in one file system."""
    return files.path("index/calibration_cameras.json")


def _tables(files: JobFiles, pattern: str, shares: int) -> list[str]:
    shares = min(shares, MOST_SHARES)
    return [files.path(pattern.format(share=f"{share:04d}")) for share in range(shares)] if shares > 1 else []


@functools.lru_cache(maxsize=256)
def _counted_views(path: Path, _changed: tuple[int, int]) -> tuple[int, int, bool]:
    """Numbers of shots and images, and whether they have times; none of a file that cannot be read.

    Each of many jobs asks.
    """
    try:
        calibration = json.loads(path.read_text())
    except (OSError, ValueError):
        return 0, 0, False
    views = calibration.get("views", []) if calibration.get("method") in BOARD_METHODS else []
    timed = bool(views) and all("time_s" in view for view in views)
    return len({view["view"] for view in views}), len(views), timed


def _changed(path: str | Path) -> tuple[int, int]:
    """Time of the last change and size, 0 without a file."""
    try:
        found = os.stat(path)
    except OSError:
        return 0, 0
    return found.st_mtime_ns, found.st_size


def _has_balls(files: JobFiles) -> bool:
    if files.settings.source != "native":
        return files.settings.source == "synthetic"
    found: object = read_description(Path(files.capture) / "capture.yaml")
    for key in ("calibration", "lights", "method"):
        found = found.get(key) if isinstance(found, dict) else None
    return found == "mirror_ball"
