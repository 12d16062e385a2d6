"""ChArUco boards of a capture, found in its images and gathered for the calibration.

If there are none, an error says why.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64

from pipeline.base.errors import Complaints, InputError
from pipeline.base.progress import progress
from pipeline.calibration.cameras.charuco import (
    Board,
    Detection,
    detect_boards,
    matching_dictionary,
    mirrored_markers,
    read_markers,
)
from pipeline.calibration.cameras.rig_model import Observations
from pipeline.calibration.cameras.rig_start import usable_views
from pipeline.capture.gray import read_gray_8bit

log = logging.getLogger("calibrate_cameras")

EXPLAINING_IMAGES = 8
"""Images in which mirrored boards and other dictionaries are sought when none is found: some will show the board."""


@dataclass(frozen=True)
class BoardViews:
    """All corners of all boards; each view is one board in one shot.

    Attributes:
        corners_m: of all boards, one after the other, each in its own frame.
        shot: number of the shot of each view.
        board: number of the board of each view.
    """

    observations: Observations
    corners_m: Float64[np.ndarray, "corners 3"]
    shot: Int64[np.ndarray, " views"]
    board: Int64[np.ndarray, " views"]

    def for_cameras(self, cameras: Sequence[int]) -> BoardViews:
        """Views of some cameras; cameras and views are numbered anew, in the order given."""
        seen = self.observations.select(np.isin(self.observations.camera, cameras))
        views, view = np.unique(seen.view, return_inverse=True)
        number = {camera: k for k, camera in enumerate(cameras)}
        camera = np.array([number[int(c)] for c in seen.camera], np.int64)
        renumbered = Observations(camera, view.astype(np.int64), seen.corner, seen.pixel)
        return BoardViews(renumbered, self.corners_m, self.shot[views], self.board[views])

    def shots_for(self, camera: int) -> Int64[np.ndarray, " shots"]:
        """Numbers of the shots in which a camera sees a board."""
        return np.unique(self.shot[self.observations.view[self.observations.camera == camera]])


def choose_shots(views: Sequence[dict], most: int | None) -> list[dict]:
    """Entries of at most so many shots, evenly spread over their numbers; all of them for None."""
    shots = np.unique([view["view"] for view in views])
    if most is not None and len(shots) > most:
        shots = shots[np.round(np.linspace(0, len(shots) - 1, most)).astype(int)]
    return [view for view in views if view["view"] in shots]


def find_boards(
    capture: Path, views: Sequence[dict], sizes: dict[str, tuple[int, int]], boards: Sequence[Board], threads: int
) -> list[list[Detection]]:
    """Per image, each board's corners in it.

    Args:
        views: entries of the index: camera, view, path.
        sizes: (width, height) of each camera's sensor.

    Raises:
        InputError: if an image has not the sensor's size, or if there is no board in any of them.
    """

    def search(view: dict, legacy: Sequence[bool]) -> tuple[list[Detection], tuple[int, int]]:
        gray = read_gray_8bit(capture / view["path"])
        return detect_boards(gray, boards, legacy), (gray.shape[1], gray.shape[0])

    def search_all(legacy: Sequence[bool]) -> list[tuple[list[Detection], tuple[int, int]]]:
        with ThreadPoolExecutor(threads) as pool:
            return list(progress(pool.map(lambda view: search(view, legacy), views), "board images", len(views)))

    found = search_all([False] * len(boards))
    legacy = [board.squares_y % 2 == 0 and _bare([d[b] for d, _ in found]) for b, board in enumerate(boards)]
    if any(legacy):
        log.info("no corners between the markers: trying the pattern printed before OpenCV 4.6")
        found = search_all(legacy)
    complaints = Complaints(capture)
    for view, (_, size) in zip(views, found, strict=True):
        if size != sizes[view["camera"]]:
            expected = "x".join(map(str, sizes[view["camera"]]))
            complaints.add(view["path"], "size", expected=f"the sensor's {expected}", found="x".join(map(str, size)))
    complaints.raise_if_any()
    detections = [each for each, _ in found]
    if not any(len(detection.ids) for each in detections for detection in each):
        raise InputError(f"{capture}: calibration.cameras: {explain_nothing(capture, views, boards, detections)}")
    return detections


def _bare(detections: Sequence[Detection]) -> bool:
    return any(d.markers for d in detections) and not any(len(d.ids) for d in detections)


def explain_nothing(
    capture: Path, views: Sequence[dict], boards: Sequence[Board], detections: Sequence[Sequence[Detection]]
) -> str:
    """Explain why no board was found in some images.

    As far as can be told: what was expected and found, and what to do.
    """
    dictionaries = " or ".join(dict.fromkeys(board.dictionary for board in boards))
    grays = [read_gray_8bit(capture / view["path"]) for view in views[:: max(1, len(views) // EXPLAINING_IMAGES)]]
    expected = f"dictionary: expected a board of {dictionaries}, found none in {len(views)} images"
    mirrored = sum(mirrored_markers(gray, boards) for gray in grays)
    if mirrored > 0:
        hint = f"in their mirror images there are {mirrored} markers: flip the images, or print the board unmirrored"
        return f"{expected}; {hint}"
    if markers := sum(detection.markers for each in detections for detection in each):
        sizes = " or ".join(dict.fromkeys(f"{board.squares_x} x {board.squares_y}" for board in boards))
        found = f"{markers} markers of it but no corner of a board of {sizes} squares"
        return f"expected the board of {dictionaries}, found {found}; check squares_x and squares_y"
    for name in dict.fromkeys(board.dictionary for board in boards):
        if len(ids := np.concatenate([read_markers(gray, name)[1] for gray in grays])):
            return f"{expected}; its markers {ids.min()} to {ids.max()} are those of no board: check first_marker"
    match = matching_dictionary(grays)
    return f"{expected}; " + (
        f"its markers match {match[0]} ({match[1]} read)" if match else "no OpenCV dictionary matches either"
    )


def gather_views(
    detections: Sequence[Sequence[Detection]], views: Sequence[dict], cameras: Sequence[str], boards: Sequence[Board]
) -> BoardViews:
    """All detections as one set of observations, without views too small to count."""
    corners = [board.corners_m() for board in boards]
    first = np.cumsum([0, *(len(points) for points in corners)])
    rows = [
        (cameras.index(view["camera"]), int(view["view"]), b, first[b] + k, *pixel)
        for view, each in zip(views, detections, strict=True)
        for b, detection in enumerate(each)
        for k, pixel in zip(detection.ids, detection.pixels, strict=True)
    ]
    table = np.array(rows, np.float64).reshape(-1, 6)
    whole = table[:, :4].astype(np.int64)
    shown, view = np.unique(whole[:, 1:3], axis=0, return_inverse=True)
    corners_m = np.concatenate(corners)
    observations = Observations(whole[:, 0], view.ravel().astype(np.int64), whole[:, 3], table[:, 4:])
    usable = observations.select(usable_views(observations, corners_m))
    return BoardViews(usable, corners_m, shown[:, 0], shown[:, 1]).for_cameras(range(len(cameras)))
