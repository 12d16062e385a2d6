"""Search for the boards of a capture in its images, all of them or those of some cameras.

If there are none, an error says why.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.base.errors import Complaints, InputError
from pipeline.base.progress import progress
from pipeline.base.spread import evenly
from pipeline.calibration.cameras.board_views import explain_nothing
from pipeline.calibration.cameras.boards import Board, Detection, detect_boards
from pipeline.calibration.cameras.rig_start import LEAST_CORNERS
from pipeline.capture.gray import read_view_gray

log = logging.getLogger("calibrate_cameras")

TRIED_IMAGES = 60
"""Images in which other prints of a board are tried: enough that some show it, even where it is mostly out of view."""


@dataclass(frozen=True)
class SearchedImage:
    """An image in which boards were looked for.

    Attributes:
        detections: each board's corners in it.
        size: its width and height.
    """

    detections: list[Detection]
    size: tuple[int, int]


@dataclass(frozen=True)
class BoardSearch:
    """Boards as they are printed, and what some images show of them.

    Attributes:
        boards: as declared, or a variant of that: inverted, of the legacy pattern.
        images: by their place in the list of views.
    """

    boards: list[Board]
    images: Mapping[int, SearchedImage]

    @property
    def detections(self) -> list[list[Detection]]:
        """Each board's corners in each of the images, in the order of the views."""
        return [self.images[place].detections for place in sorted(self.images)]


def find_boards(
    capture: Path, views: Sequence[dict], sizes: dict[str, tuple[int, int]], boards: Sequence[Board], threads: int
) -> BoardSearch:
    """Find each board in each image.

    A board that was printed in another way is found as it is, and that is logged.

    Args:
        views: entries of the index: camera, view, path.
        sizes: (width, height) of each camera's sensor.

    Raises:
        InputError: if an image has not the sensor's size, or if there is no board in any of them.
    """
    searched = search_images(capture, views, range(len(views)), boards, threads)
    check_search(capture, views, sizes, boards, searched)
    return searched


def search_images(
    capture: Path, views: Sequence[dict], places: Sequence[int], boards: Sequence[Board], threads: int
) -> BoardSearch:
    """Search some images, and complain about nothing.

    How boards are printed is read in a few of all images: whoever searches others finds the same.

    Args:
        views: entries of the index, of all images.
        places: of those to search, in that list.
    """

    def search(place: int, boards: Sequence[Board]) -> SearchedImage:
        gray = read_view_gray(capture, views[place])
        return SearchedImage(detect_boards(gray, boards), (gray.shape[1], gray.shape[0]))

    def search_all(places: Sequence[int], boards: Sequence[Board]) -> dict[int, SearchedImage]:
        with ThreadPoolExecutor(threads) as pool:
            made = pool.map(lambda place: search(place, boards), places)
            return dict(zip(places, progress(made, "board images", len(places)), strict=True))

    sample, printed = evenly(range(len(views)), TRIED_IMAGES), list(boards)
    searched = search_all(sample, boards)
    for b, board in enumerate(boards):
        if not any(_is_seen(image.detections[b]) for image in searched.values()):
            variants = board.variants()
            tried = [image.detections for image in search_all(sample, variants).values()]
            seen = [sum(len(each[k].ids) for each in tried if _is_seen(each[k])) for k in range(len(variants))]
            printed[b] = variants[int(np.argmax(seen))]
    if printed != list(boards):
        searched = {}
    searched |= search_all([place for place in places if place not in searched], printed)
    return BoardSearch(printed, {place: searched[place] for place in places})


def check_search(
    capture: Path, views: Sequence[dict], sizes: dict[str, tuple[int, int]], boards: Sequence[Board],
    searched: BoardSearch,
) -> None:  # fmt: skip
    """Check a search of all images, and log boards that are not printed as declared.

    Args:
        boards: as they are declared.

    Raises:
        InputError: if an image has not the sensor's size, or if there is no board in any of them.
    """
    for b, (board, printed) in enumerate(zip(boards, searched.boards, strict=True)):
        if printed != board:
            log.info("board %d: declared %s; found: %s", b, board.describe(), printed.describe())
    complaints = Complaints(capture)
    for place, view in enumerate(views):
        image = searched.images[place]
        if image.size != sizes[view["camera"]]:
            expected, size = ("x".join(map(str, each)) for each in (sizes[view["camera"]], image.size))
            complaints.add(view["path"], "size", expected=f"the sensor's {expected}", found=size)
    complaints.raise_if_any()
    detections = searched.detections
    if not any(len(detection.ids) for each in detections for detection in each):
        raise InputError(
            f"{capture}: calibration.cameras: {explain_nothing(capture, views, searched.boards, detections)}"
        )


def _is_seen(detection: Detection) -> bool:
    """True for a board of enough corners to count."""
    return len(detection.ids) >= LEAST_CORNERS
