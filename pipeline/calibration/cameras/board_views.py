"""Boards that were found in images, gathered for the calibration.

If there are none, an explanation why.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64, UInt8

from pipeline.base.spread import evenly
from pipeline.calibration.cameras.board_identity import identify_board
from pipeline.calibration.cameras.board_motion import restful_shots, with_motion
from pipeline.calibration.cameras.boards import Board, BoardPhoto, Detection
from pipeline.calibration.cameras.rig_inputs import Observations
from pipeline.calibration.cameras.rig_start import usable_views
from pipeline.capture.gray import read_view_gray

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
        renumbered = replace(seen, camera=camera, view=view.astype(np.int64))
        return BoardViews(renumbered, self.corners_m, self.shot[views], self.board[views])

    def moving(self, times_s: Mapping[tuple[int, int], float]) -> BoardViews:
        """The views with their corners' velocities; `times_s`: when each (camera, shot) was taken."""
        moving = with_motion(self.observations, self.shot, self.board, times_s)
        return replace(self, observations=moving).for_cameras(range(int(self.observations.camera.max()) + 1))

    def resting(self, most: int | None) -> BoardViews:
        """At most so many shots of moving views, evenly spread, where boards rest; None: all."""
        if most is None:
            return self
        kept = np.isin(self.shot, restful_shots(self.observations, self.shot, most))
        still = replace(self, observations=self.observations.select(kept[self.observations.view]))
        return still.for_cameras(range(int(self.observations.camera.max()) + 1))

    def shots_for(self, camera: int) -> Int64[np.ndarray, " shots"]:
        """Numbers of the shots in which a camera sees a board."""
        return np.unique(self.shot[self.observations.view[self.observations.camera == camera]])


def choose_shots(views: Sequence[dict], most: int | None) -> list[dict]:
    """Entries of at most so many shots, evenly spread over their numbers; all of them for None."""
    shots = np.unique([view["view"] for view in views])
    if most is not None and len(shots) > most:
        shots = shots[np.round(np.linspace(0, len(shots) - 1, most)).astype(int)]
    return [view for view in views if view["view"] in shots]


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
    parts = [
        np.column_stack(
            [
                np.tile([cameras.index(view["camera"]), int(view["view"]), b], (len(detection.ids), 1)),
                first[b] + detection.ids,
                detection.pixels,
            ]
        )
        for view, each in zip(views, detections, strict=True)
        for b, detection in enumerate(each)
    ]
    table = np.concatenate([np.zeros((0, 6)), *parts])
    whole = table[:, :4].astype(np.int64)
    shown, view = np.unique(whole[:, 1:3], axis=0, return_inverse=True)
    corners_m = np.concatenate(corners)
    observations = Observations(whole[:, 0], view.ravel().astype(np.int64), whole[:, 3], table[:, 4:])
    usable = observations.select(usable_views(observations, corners_m))
    return BoardViews(usable, corners_m, shown[:, 0], shown[:, 1]).for_cameras(range(len(cameras)))
