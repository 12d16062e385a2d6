"""Boards of a capture, found in its images and gathered for the calibration.

If there are none, an error says why.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64, UInt8

from pipeline.base.errors import Complaints, InputError
from pipeline.base.progress import progress
from pipeline.base.spread import evenly
from pipeline.calibration.cameras.board_identity import identify_board
from pipeline.calibration.cameras.board_motion import with_motion
from pipeline.calibration.cameras.boards import Board, BoardPhoto, Detection, detect_boards
from pipeline.calibration.cameras.rig_inputs import Observations
from pipeline.calibration.cameras.rig_start import LEAST_CORNERS, usable_views
from pipeline.capture.gray import read_view_gray

log = logging.getLogger("calibrate_cameras")

EXPLAINING_IMAGES = 8
"""Images in which mirrored boards and other dictionaries are sought when none is found: some will show the board."""

TRIED_IMAGES = 60
"""Images in which other prints of a board are tried: enough that some show it, even where it is mostly out of view."""


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
        renumbered = replace(seen, camera=camera, view=view.astype(np.int64))
        return BoardViews(renumbered, self.corners_m, self.shot[views], self.board[views])

    def moving(self, times_s: Mapping[tuple[int, int], float]) -> BoardViews:
        """The views with their corners' velocities; `times_s`: when each (camera, shot) was taken."""
        moving = with_motion(self.observations, self.shot, self.board, times_s)
        return replace(self, observations=moving).for_cameras(range(int(self.observations.camera.max()) + 1))

    def shots_for(self, camera: int) -> Int64[np.ndarray, " shots"]:
        """Numbers of the shots in which a camera sees a board."""
        return np.unique(self.shot[self.observations.view[self.observations.camera == camera]])


def choose_shots(views: Sequence[dict], most: int | None) -> list[dict]:
    """Entries of at most so many shots, evenly spread over their numbers; all of them for None."""
    shots = np.unique([view["view"] for view in views])
    if most is not None and len(shots) > most:
        shots = shots[np.round(np.linspace(0, len(shots) - 1, most)).astype(int)]
    return [view for view in views if view["view"] in shots]


Searched = tuple[list[Detection], tuple[int, int]]
"""Each board's corners in an image, and its width and height."""


@dataclass(frozen=True)
class FoundBoards:
    """Boards as they are printed, and where they are.

    Attributes:
        boards: as declared, or a variant of that: inverted, of the legacy pattern.
        detections: per image, each board's corners in it.
    """

    boards: list[Board]
    detections: list[list[Detection]]


def find_boards(
    capture: Path, views: Sequence[dict], sizes: dict[str, tuple[int, int]], boards: Sequence[Board], threads: int
) -> FoundBoards:
    """Find each board in each image.

    A board that was printed in another way is found as it is, and that is logged.

    Args:
        views: entries of the index: camera, view, path.
        sizes: (width, height) of each camera's sensor.

    Raises:
        InputError: if an image has not the sensor's size, or if there is no board in any of them.
    """

    def search(place: int, boards: Sequence[Board]) -> Searched:
        gray = read_view_gray(capture, views[place])
        return detect_boards(gray, boards), (gray.shape[1], gray.shape[0])

    def search_all(places: Sequence[int], boards: Sequence[Board]) -> dict[int, Searched]:
        with ThreadPoolExecutor(threads) as pool:
            made = pool.map(lambda place: search(place, boards), places)
            return dict(zip(places, progress(made, "board images", len(places)), strict=True))

    sample, printed = evenly(range(len(views)), TRIED_IMAGES), list(boards)
    searched = search_all(sample, boards)
    for b, board in enumerate(boards):
        if not any(_is_seen(detections[b]) for detections, _ in searched.values()):
            variants = board.variants()
            tried = [each for each, _ in search_all(sample, variants).values()]
            seen = [sum(len(each[k].ids) for each in tried if _is_seen(each[k])) for k in range(len(variants))]
            printed[b] = variants[int(np.argmax(seen))]
            if printed[b] != board:
                log.info("board %d: declared %s; found: %s", b, board.describe(), printed[b].describe())
    if printed != list(boards):
        searched = {}
    searched |= search_all([place for place in range(len(views)) if place not in searched], printed)
    found = [searched[place] for place in range(len(views))]
    complaints = Complaints(capture)
    for view, (_, size) in zip(views, found, strict=True):
        if size != sizes[view["camera"]]:
            expected = "x".join(map(str, sizes[view["camera"]]))
            complaints.add(view["path"], "size", expected=f"the sensor's {expected}", found="x".join(map(str, size)))
    complaints.raise_if_any()
    detections = [each for each, _ in found]
    if not any(len(detection.ids) for each in detections for detection in each):
        raise InputError(f"{capture}: calibration.cameras: {explain_nothing(capture, views, printed, detections)}")
    return FoundBoards(printed, detections)


def _is_seen(detection: Detection) -> bool:
    """True for a board of enough corners to count."""
    return len(detection.ids) >= LEAST_CORNERS


def explain_nothing(
    capture: Path, views: Sequence[dict], boards: Sequence[Board], detections: Sequence[Sequence[Detection]]
) -> str:
    """Explain why no board was found in some images.

    As far as can be told: what was expected and found, and what to do.
    """
    names = list(dict.fromkeys(board.markers_of for board in boards if board.markers_of))
    wanted = " or ".join(names or dict.fromkeys(board.describe() for board in boards))
    grays = [read_view_gray(capture, view) for view in evenly(views, EXPLAINING_IMAGES)]
    expected = f"{'dictionary: ' * bool(names)}expected a board of {wanted}, found none in {len(views)} images"
    mirrored = sum(mirrored_markers(gray, boards) for gray in grays)
    sure = 2 * mirrored > len(grays) * max(len(board.markers) for board in boards) > 0
    match = None if sure else identify_board(grays, boards)
    if sure or mirrored > (match.markers if match else 0):
        hint = f"in their mirror images there are {mirrored} markers: flip the images, or print the board unmirrored"
        return f"{expected}; {hint}"
    told = "" if match is None or match.board is None else f"; found: {match.describe()}"
    if markers := sum(detection.markers for each in detections for detection in each):
        described = " or ".join(dict.fromkeys(board.describe() for board in boards))
        found = f"{markers} markers of it but no corner of a board of {described}"
        return f"expected the board of {wanted}, found {found}; check squares_x and squares_y{told}"
    for name, inverted in dict.fromkeys((board.markers_of, board.inverted) for board in boards if board.markers_of):
        if len(ids := np.concatenate([BoardPhoto(gray).markers(name, inverted)[1] for gray in grays])):
            return f"{expected}; its markers {ids.min()} to {ids.max()} are those of no board: check first_marker{told}"
    if match is None:
        return f"{expected}; no OpenCV dictionary matches either"
    if match.dictionary is None:
        return f"{expected}{told}"
    return f"{expected}; its markers match {match.dictionary} ({match.markers} read){told}"


def mirrored_markers(gray: UInt8[np.ndarray, "height width"], boards: Sequence[Board]) -> int:
    """Number of markers in the mirror image of an image, less those in itself.

    Of the boards' dictionaries.
    """
    photo, mirror = BoardPhoto(gray), BoardPhoto(np.ascontiguousarray(gray[:, ::-1]))
    read = {(board.markers_of, inverted) for board in boards if board.markers_of for inverted in (False, True)}
    return sum(len(mirror.markers(*key)[1]) - len(photo.markers(*key)[1]) for key in read)


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
