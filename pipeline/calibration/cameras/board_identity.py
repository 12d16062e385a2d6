"""Identification of boards that are not as declared.

Their dictionary, size and pattern, and whether they are inverted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float64, Int64, UInt8

from pipeline.calibration.cameras.boards import Board, BoardPhoto, dictionary_names, opencv_dictionary
from pipeline.calibration.cameras.charuco import CharucoBoard
from pipeline.calibration.cameras.plain_grids import Checkerboard
from pipeline.calibration.cameras.tag_grids import TAG_CORNERS, TagGrid

LEAST_MARKERS = 4
"""Markers in one image that tell a layout: fewer fit several."""

CLEAREST = 4
"""Images, those with most markers, by which layouts are compared."""

MOST_SQUARES = 24
"""Squares along a side up to which layouts are tried: boards of more are not printed."""

ASSUMED_MARKER = 0.75
"""Side of a marker over its square's, or over the distance of two tags, where nothing is declared."""

TOLERANCE = 0.2
"""Distance of a marker's corner from where a layout has it, over the square's side, up to which it fits: a marker of
half the assumed size is off by 0.18, a marker of another place by 1."""

FITTING = 0.8
"""Share of the markers that have to fit a layout: noise that is read as markers does not count."""

SAMPLES = 300
"""Homographies of four corners that are tried for a layout: of a layout that fits, FITTING ** 4 of them, a hundred and
more, are of markers in their places; of the others, each takes as long and finds nothing."""

SMALL_DICTIONARY = 100
"""Markers of a dictionary that is tried first. Each marker costs time, so all dictionaries take ten times as long; they
are tried if what the small ones read is no board."""

SMALLEST_BOARD = (3, 3)
"""Inner corners of the smallest checkerboard that is looked for."""


@dataclass(frozen=True)
class Found:
    """A board as some images show it.

    Attributes:
        dictionary: of its markers, and how many of them were read; None for a board without markers.
        board: the whole board, its lengths only guessed; None where the layout cannot be told.
    """

    dictionary: str | None
    inverted: bool
    markers: int
    board: Board | None

    def describe(self) -> str:
        """The board in words."""
        if self.board is not None:
            return self.board.describe()
        return f"{self.dictionary}" + ", inverted" * self.inverted


@dataclass(frozen=True)
class _Seen:
    """Markers in one image."""

    ids: Int64[np.ndarray, " markers"]
    corners: Float64[np.ndarray, "markers 4 2"]


def identify_board(grays: Sequence[UInt8[np.ndarray, "height width"]], declared: Sequence[Board]) -> Found | None:
    """The board that most markers in some images belong to, or a checkerboard.

    None if there is neither.
    """
    photos = [BoardPhoto(gray) for gray in grays]
    likely = [board.markers_of for board in declared if board.markers_of]
    small = [name for name in dictionary_names() if len(opencv_dictionary(name).bytesList) <= SMALL_DICTIONARY]
    match = matching_dictionary(photos, likely, small)
    if match and (found := _found(photos, matching_dictionary(photos, likely, _family(match[0])), declared)).board:
        return found
    match = matching_dictionary(photos, likely, dictionary_names())
    return _found(photos, match, declared) if match else _identify_checkerboard(photos)


def matching_dictionary(
    photos: Sequence[BoardPhoto], declared: Sequence[str], names: Sequence[str]
) -> tuple[str, bool, int] | None:
    """Dictionary, of some, that reads most markers; whether inverted, and how many they are.

    None if none reads any.

    Of equals a declared one, else the smallest.
    """
    counts = {}
    for name in names:
        for inverted in (False, True):
            found = sum(len(photo.markers(name, inverted)[1]) for photo in photos)
            counts[name, inverted] = (found, name in declared, not inverted, -len(opencv_dictionary(name).bytesList))
    best = max(counts, key=lambda key: counts[key])
    return (*best, counts[best][0]) if counts[best][0] else None


def _family(name: str) -> list[str]:
    """Dictionaries that share their first markers: DICT_4X4_50, 100, 250 and 1000."""
    stem, _, count = name.rpartition("_")
    alike = [other for other in dictionary_names() if other.startswith(f"{stem}_")]
    return alike if count.isdigit() else [name]


def _found(photos: Sequence[BoardPhoto], match: tuple[str, bool, int], declared: Sequence[Board]) -> Found:
    """The board of the markers of a dictionary."""
    dictionary, inverted, count = match
    seen = []
    for photo in photos:
        corners, ids = photo.markers(dictionary, inverted)
        if len(ids) >= LEAST_MARKERS:
            seen.append(_Seen(ids.astype(np.int64), np.concatenate(corners).reshape(-1, 4, 2).astype(np.float64)))
    board = _identify_layout(seen, dictionary, declared)
    return Found(dictionary, inverted, count, None if board is None else replace(board, inverted=inverted))


def _identify_layout(seen: Sequence[_Seen], dictionary: str, declared: Sequence[Board]) -> Board | None:
    """The layout that most markers fit; None if too few do, or others do as well."""
    clearest = sorted(seen, key=lambda each: -len(each.ids))[:CLEAREST]
    total = sum(len(each.ids) for each in clearest)
    if total == 0:
        return None
    markers = np.concatenate([each.ids for each in seen])
    alike = [board for board in declared if board.markers_of == dictionary]
    firsts = {0, *(getattr(board, "first_marker", getattr(board, "first_tag", 0)) for board in alike)}
    fits: dict[Board, int] = {}
    for first in sorted(firsts):
        for board in _layouts(dictionary, first, int(np.bincount(markers).argmax()), int(markers.max())):
            fits[board] = sum(_fitting(board, each) for each in clearest)
    best = max(fits, key=lambda board: (fits[board], board in declared))
    rivals = [board for board in fits if fits[board] == fits[best]]
    return best if fits[best] >= FITTING * total and len(rivals) == 1 else None


def _layouts(dictionary: str, first: int, usual: int, last: int) -> list[Board]:
    """Boards whose markers are numbered from `first` to `last`, of all widths."""
    count, boards = last - first + 1, []
    if usual < first or count < LEAST_MARKERS:
        return []
    for x in range(2, MOST_SQUARES + 1):
        y = -(-2 * count // x)
        charuco = CharucoBoard(x, y, 1.0, ASSUMED_MARKER, dictionary, first)
        if y > 1:
            boards += [charuco, replace(charuco, legacy=True)] if y % 2 == 0 else [charuco]
        boards.append(TagGrid(x, -(-count // x), ASSUMED_MARKER, 1 - ASSUMED_MARKER, dictionary, first))
    return boards


def _fitting(board: Board, seen: _Seen) -> int:
    """Number of markers that lie where a board has them, as some homography sees it."""
    if isinstance(board, TagGrid):
        places = board.corners_m()[:, :2].reshape(-1, 4, 2)
        first = board.first_tag
    else:
        y, x = np.divmod(np.arange(board.squares_x * board.squares_y), board.squares_x)
        white = (x + y) % 2 == (0 if board.legacy else 1)
        corner = np.stack([x, y], 1)[white] + (1 - ASSUMED_MARKER) / 2
        places, first = corner[:, None] + ASSUMED_MARKER * TAG_CORNERS, board.first_marker
    own = (seen.ids >= first) & (seen.ids < first + len(places))
    if own.sum() < LEAST_MARKERS:
        return 0
    on_board, pixels = places[seen.ids[own] - first], seen.corners[own]
    # From pixels to the board, where the tolerance is known.
    points = (pixels.reshape(-1, 2), on_board.reshape(-1, 2))
    homography, _ = cv2.findHomography(*points, cv2.RANSAC, TOLERANCE, maxIters=SAMPLES)
    if homography is None:
        return 0
    back = cv2.perspectiveTransform(pixels.reshape(1, -1, 2), homography).reshape(-1, 4, 2)
    return int((np.linalg.norm(back - on_board, axis=-1).max(1) < TOLERANCE).sum())


def _identify_checkerboard(photos: Sequence[BoardPhoto]) -> Found | None:
    flags = cv2.CALIB_CB_LARGER | cv2.CALIB_CB_EXHAUSTIVE
    for inverted in (False, True):
        sizes = []
        for photo in photos:
            gray = photo.negative if inverted else photo.gray
            found, _, meta = cv2.findChessboardCornersSBWithMeta(gray, SMALLEST_BOARD, flags)
            if found:
                sizes.append((meta.shape[1] + 1, meta.shape[0] + 1))
        if sizes:
            # The most frequent; of the others, parts of the board were hidden.
            return Found(None, inverted, 0, Checkerboard(*max(sizes, key=sizes.count), 1.0, inverted=inverted))
    return None
