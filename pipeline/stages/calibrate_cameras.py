"""Calibrate intrinsics, distortion and poses of all cameras from images of boards.

They are metric, in the rig's own frame.

Corners are detected in every image, each camera is calibrated alone (Zhang 2000), cameras are joined through the views
they share, and one bundle adjustment over everything refines the result. Each camera is then judged, and one that moved
between views is named. The rig's frame is that of the first board view; calibrate_lights moves it into the stage's.
Given lenses may stay or be refined; images that were not taken at once may have times. With `method: features` the
subject's own points stand in for the boards; with `method: known` the given cameras are validated and copied.

Of many images, a job of its own searches each share; the cameras that are then calibrated by the tables of these jobs
are the same.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pipeline.base.command import run_as_command
from pipeline.base.errors import Complaints, InputError
from pipeline.base.files import read_json, read_table, write_table
from pipeline.base.verdicts import log_verdicts, verdict_table
from pipeline.calibration.cameras.board_calibration import calibrate_from_boards
from pipeline.calibration.cameras.board_tables import search_share
from pipeline.calibration.cameras.camera_calibration import CameraCalibration, given_calibration
from pipeline.capture.cameras.known_cameras import read_known_cameras
from pipeline.capture.schema.camera_schema import KnownCameras
from pipeline.config.calibrate_cameras import BOARD_METHODS, CalibrateCameras
from pipeline.geometry.cameras import write_cameras

log = logging.getLogger("calibrate_cameras")


def run(
    *,
    capture: Path,
    index: Path,
    out: Path,
    threads: int = 1,
    found: tuple[Path, ...] = (),
    share: int | None = None,
    shares: int = 1,
    settings: CalibrateCameras = CalibrateCameras(),
) -> None:
    """Calibrate all cameras of a rig together from images of boards.

    Args:
        capture: folder of the capture.
        index: folder that index_capture wrote.
        out: folder to write rig.json, residuals_cameras.parquet, quality_cameras.parquet, pairs_cameras.parquet and
            verdicts_cameras.csv to; with `share`, SHARE.parquet.
        threads: images searched at a time.
        found: tables that were written with `share`, of all shares: no board is looked for again.
        share: look for boards only in this share of the images, from 0, and write a table of them.
        shares: number of shares.
        settings: see the flags below.
    """
    calibration = read_json(index / "calibration_cameras.json")
    method = calibration["method"]
    if (share is not None or found) and method not in BOARD_METHODS:
        expected = f"one with boards to look for, {' or '.join(BOARD_METHODS)}"
        file, hint = index / "calibration_cameras.json", "leave --share and --found out"
        raise InputError(f"{file}: method: expected {expected}, found {method}; {hint}")
    if share is not None:
        search_share(capture, calibration, out / f"{share:04d}.parquet", share, shares, settings, threads)
        return
    table = read_table(index / "cameras.parquet").sort_values("camera")
    sizes = {row.camera: (int(row.sensor_width), int(row.sensor_height)) for row in table.itertuples()}
    if method == "known":
        done = known_cameras(capture, calibration, sizes)
    elif method == "features":
        # Imports pycolmap, which loads all of COLMAP.
        from pipeline.calibration.cameras.feature_calibration import calibrate_from_features

        done = calibrate_from_features(capture, calibration, sizes, settings, threads)
    else:
        done = calibrate_from_boards(capture, calibration, sizes, settings, threads, found)
    log_verdicts(log, done.verdicts)
    done.complaints.raise_if_any()
    write_cameras(out / "rig.json", done.cameras)
    write_table(out / "residuals_cameras.parquet", done.residuals)
    write_table(out / "quality_cameras.parquet", done.quality)
    write_table(out / "pairs_cameras.parquet", done.pairs)
    write_table(out / "verdicts_cameras.csv", verdict_table(done.verdicts))


def known_cameras(
    capture: Path, calibration: Mapping[str, Any], sizes: Mapping[str, tuple[int, int]]
) -> CameraCalibration:
    """Given cameras, those of the index only, in metres.

    Raises:
        InputError: naming cameras that are not there or cannot be right.
    """
    section = KnownCameras.model_validate({key: value for key, value in calibration.items() if key != "digest"})
    complaints = Complaints(capture)
    cameras = read_known_cameras(capture, section, sizes, complaints)
    complaints.raise_if_any()
    return given_calibration(cameras, complaints)


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
