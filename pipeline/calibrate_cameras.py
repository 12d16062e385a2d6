"""Images of a ChArUco board -> intrinsics, distortion and poses of all cameras, metric, in the rig's own frame.

Corners are detected in every image, each camera is calibrated alone (Zhang 2000), cameras are joined through the views
they share, and one bundle adjustment over everything refines the result. The rig's frame is that of the first
board view; calibrate_lights moves it into the stage's. With `method: known` the given cameras are validated and copied.
"""

from __future__ import annotations

import logging
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import pandas as pd

from pipeline.base.command import run_as_command
from pipeline.base.errors import Complaints, InputError
from pipeline.base.files import read_json, read_table, write_table
from pipeline.base.progress import progress
from pipeline.capture.gray import read_gray_8bit
from pipeline.config.calibrate_cameras import CalibrateCameras
from pipeline.geometry.cameras import Camera, read_cameras, write_cameras
from pipeline.geometry.charuco import Board, Detection, detect_board, dictionary_names, matching_dictionary
from pipeline.geometry.rig import Observations, Rig, adjust_rig
from pipeline.geometry.rig_start import connected_groups, start_rig, usable_views, view_rows

log = logging.getLogger("calibrate_cameras")

DICTIONARY_IMAGES = 8
"""Images in which other dictionaries are tried when none is found: enough that some show the board."""


def run(
    *, capture: Path, index: Path, out: Path, threads: int = 1, settings: CalibrateCameras = CalibrateCameras()
) -> None:
    """Calibrate all cameras of a rig together from images of a ChArUco board.

    Args:
        capture: folder of the capture.
        index: folder that index_capture wrote.
        out: folder to write rig.json and residuals_cameras.parquet to.
        threads: images searched at a time.
    """
    calibration = read_json(index / "calibration_cameras.json")
    table = read_table(index / "cameras.parquet").sort_values("camera")
    sizes = {row.camera: (int(row.sensor_width), int(row.sensor_height)) for row in table.itertuples()}
    if calibration["method"] == "known":
        write_cameras(out / "rig.json", known_cameras(capture / calibration["path"], sizes))
        write_table(out / "residuals_cameras.parquet", residual_table(None, None, [], []))
        return
    board = Board(*(calibration[key] for key in ("squares_x", "squares_y", "square_m", "marker_m", "dictionary")))
    if not (board.dictionary.startswith("DICT_") and hasattr(cv2.aruco, board.dictionary)):
        raise InputError(f"capture.yaml: dictionary: expected one of {dictionary_names()}, found {board.dictionary}")
    views = calibration["views"]
    detections = detect(capture, views, sizes, board, threads)
    observations = gather(detections, views, list(sizes), board)
    check(observations, list(sizes), settings.least_views, capture)
    names, view_numbers = list(sizes), np.unique(observations.view)
    numbered = Observations(
        observations.camera, np.searchsorted(view_numbers, observations.view), observations.corner, observations.pixel
    )
    start = start_rig(numbered, board.corners_m(), list(sizes.values()))
    rig = adjust_rig(numbered, board.corners_m(), start.cameras, start.rig_from_board, settings.distortion)
    report(rig, numbered, names, settings, capture)
    write_cameras(out / "rig.json", dict(zip(names, rig.cameras, strict=True)))
    write_table(out / "residuals_cameras.parquet", residual_table(rig, numbered, names, view_numbers))


def known_cameras(path: Path, sizes: dict[str, tuple[int, int]]) -> dict[str, Camera]:
    """Given cameras, those of the index only, after checking that they are all there and of the sensor's size."""
    given, complaints = read_cameras(path), Complaints(path)
    for name, (width, height) in sizes.items():
        found = f"{given[name].width} x {given[name].height}" if name in given else "nothing"
        if found != f"{width} x {height}":
            expected = f"a camera of {width} x {height} sensor pixels"
            complaints.add(path, f"camera {name}", expected=expected, found=found)
    complaints.raise_if_any()
    return {name: given[name] for name in sizes}


def detect(
    capture: Path, views: list[dict], sizes: dict[str, tuple[int, int]], board: Board, threads: int
) -> list[Detection]:
    """The board in every image.

    Raises:
        InputError: if an image has not the sensor's size, or if the board is in none of them.
    """

    def search(view: dict, legacy: bool = False) -> tuple[Detection, tuple[int, int]]:
        gray = read_gray_8bit(capture / view["path"])
        return detect_board(gray, board, legacy), (gray.shape[1], gray.shape[0])

    with ThreadPoolExecutor(threads) as pool:
        found = list(progress(pool.map(search, views), "board images", len(views)))
        if board.squares_y % 2 == 0 and any(d.markers for d, _ in found) and not any(len(d.ids) for d, _ in found):
            log.info("no corners between the markers: trying the pattern printed before OpenCV 4.6")
            found = list(progress(pool.map(lambda view: search(view, legacy=True), views), "board images", len(views)))
    complaints = Complaints(capture)
    for view, (_, size) in zip(views, found, strict=True):
        if size != sizes[view["camera"]]:
            expected = "x".join(map(str, sizes[view["camera"]]))
            complaints.add(view["path"], "size", expected=f"the sensor's {expected}", found="x".join(map(str, size)))
    complaints.raise_if_any()
    if not any(len(detection.ids) for detection, _ in found):
        raise InputError(explain_nothing(capture, views, board, sum(d.markers for d, _ in found)))
    return [detection for detection, _ in found]


def explain_nothing(capture: Path, views: list[dict], board: Board, markers: int) -> str:
    """Why the board was found in no image, as far as can be told."""
    where = f"{capture}: calibration.cameras"
    if markers:
        size = f"{board.squares_x} x {board.squares_y}"
        found = f"{markers} markers of it but no corner of a board of {size} squares"
        return f"{where}: expected the board of {board.dictionary}, found {found}; check squares_x and squares_y"
    step = max(1, len(views) // DICTIONARY_IMAGES)
    match = matching_dictionary(read_gray_8bit(capture / view["path"]) for view in views[::step][:DICTIONARY_IMAGES])
    hint = f"its markers match {match[0]} ({match[1]} read)" if match else "no OpenCV dictionary matches either"
    return f"{where}: dictionary: expected a board of {board.dictionary}, found none in {len(views)} images; {hint}"


def gather(detections: list[Detection], views: list[dict], names: list[str], board: Board) -> Observations:
    """All detections as one set of observations, without views too small to count."""
    counts = [len(detection.ids) for detection in detections]
    observations = Observations(
        np.repeat([names.index(view["camera"]) for view in views], counts).astype(np.int64),
        np.repeat([int(view["view"]) for view in views], counts).astype(np.int64),
        np.concatenate([detection.ids for detection in detections]),
        np.concatenate([detection.pixels for detection in detections]),
    )
    return observations.select(usable_views(observations, board.corners_m()))


def check(observations: Observations, names: list[str], least_views: int, capture: Path) -> None:
    """Raises:
    InputError: naming cameras with too few views, or the groups that share none.
    """
    complaints = Complaints(capture)
    count = np.bincount([camera for camera, _ in view_rows(observations)], minlength=len(names))
    for name, views in zip(names, count, strict=True):
        if views < least_views:
            expected, mend = f"the board in at least {least_views} views", "record more, or remove the camera"
            complaints.add("calibration.cameras", f"camera {name}", expected=expected, found=f"{views}", mend=mend)
    complaints.raise_if_any()
    groups = connected_groups(observations, len(names))
    if len(groups) > 1:
        found = "; ".join(f"({', '.join(names[c] for c in group)})" for group in groups)
        mend = "record views in which cameras of different groups see the board at once"
        expected = "cameras joined by shared views"
        complaints.add("calibration.cameras", "views", expected=expected, found=found, mend=mend)
    complaints.raise_if_any()


def report(rig: Rig, observations: Observations, names: list[str], settings: CalibrateCameras, capture: Path) -> None:
    """Log one line per camera.

    Raises:
        InputError: naming cameras whose views leave the focal length open.
    """
    complaints = Complaints(capture)
    squared = (rig.residual**2).sum(1)
    for c, name in enumerate(names):
        mine = observations.camera == c
        rms, views = np.sqrt(squared[mine].mean()), len(np.unique(observations.view[mine]))
        verdict = "good" if rms <= settings.good_rms_px else "POOR: look at its residuals"
        focal, center = rig.focal_sigma[c], 1000 * rig.center_sigma_m[c]
        text = "%s: %d views, %d corners, RMS %.3f px, focal length +-%.3f %%, centre +-%.2f mm: %s"
        log.info(text, name, views, mine.sum(), rms, 100 * focal, center, verdict)
        if focal > settings.largest_focal_error:
            expected = f"a focal length known to {100 * settings.largest_focal_error:g} %"
            mend = "record views of the board tilted by 30 degrees and more, and at several distances"
            found = f"{100 * focal:.1f} %"
            complaints.add("calibration.cameras", f"camera {name}", expected=expected, found=found, mend=mend)
    log.info("all: %d corners, RMS %.3f px, noise %.3f px", len(squared), np.sqrt(squared.mean()), rig.sigma_px)
    complaints.raise_if_any()


def residual_table(
    rig: Rig | None, observations: Observations | None, names: list[str], view_numbers: np.ndarray | list[int]
) -> pd.DataFrame:
    """One row per corner: camera, view, corner, x, y, residual_x, residual_y (projected minus observed), weight."""
    columns = ["camera", "view", "corner", "x", "y", "residual_x", "residual_y", "weight"]
    if rig is None or observations is None:
        return pd.DataFrame({name: pd.Series(dtype="str" if name == "camera" else "float64") for name in columns})
    camera, view = np.array(names)[observations.camera], np.asarray(view_numbers)[observations.view]
    values = [camera, view, observations.corner, *observations.pixel.T, *rig.residual.T, rig.weight]
    return pd.DataFrame(dict(zip(columns, values, strict=True)))


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
