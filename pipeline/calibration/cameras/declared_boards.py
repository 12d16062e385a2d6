"""Declarations of a capture about its boards: their kinds, lenses and times.

From the index's calibration_cameras.json.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import cv2

from pipeline.base.errors import Complaints, InputError, listed
from pipeline.calibration.cameras.board_views import choose_shots
from pipeline.calibration.cameras.boards import Board, dictionary_names
from pipeline.calibration.cameras.charuco import CharucoBoard
from pipeline.calibration.cameras.plain_grids import Checkerboard, CircleGrid
from pipeline.calibration.cameras.rig_inputs import RigPriors
from pipeline.calibration.cameras.tag_grids import TagGrid
from pipeline.capture.cameras.known_cameras import read_known_lenses
from pipeline.capture.schema.camera_schema import CameraFile
from pipeline.config.calibrate_cameras import CalibrateCameras
from pipeline.geometry.lens import Lens
from pipeline.geometry.lenses import BROWN_CONRADY, LENSES

KINDS: Mapping[str, type[Board]] = {
    "charuco": CharucoBoard,
    "tag_grids": TagGrid,
    "checkerboards": Checkerboard,
    "circle_grids": CircleGrid,
}
"""Class of each list of boards of method `boards`; boards are counted in this order."""


def boards_from_index(calibration: Mapping[str, Any]) -> list[Board]:
    """Boards of the index's calibration_cameras.json.

    They are the lists of method `boards`; of method `charuco` its list, or the one board whose keys stand there.

    Raises:
        InputError: if OpenCV has no such dictionary.
    """
    if calibration.get("method") == "boards":
        boards = [_board(kind, entry) for key, kind in KINDS.items() for entry in calibration.get(key, [])]
    else:
        boards = [_board(CharucoBoard, entry) for entry in calibration.get("boards") or [calibration]]
    for board in boards:
        name = board.markers_of
        if name is not None and not (name.startswith("DICT_") and hasattr(cv2.aruco, name)):
            raise InputError(f"capture.yaml: dictionary: expected one of {dictionary_names()}, found {name}")
    return boards


def _board(kind: type[Board], entry: Mapping[str, Any]) -> Board:
    return kind(**{field.name: entry[field.name] for field in fields(kind) if field.name in entry})


def times_from_index(calibration: Mapping[str, Any]) -> dict[tuple[str, int], float] | None:
    """Time of each (camera, view), seconds; None where images of a view were taken at once."""
    views = calibration["views"]
    if not views or any("time_s" not in view for view in views):
        return None
    return {(view["camera"], view["view"]): view["time_s"] for view in views}


def views_to_search(calibration: Mapping[str, Any], settings: CalibrateCameras) -> list[dict]:
    """Views in which boards are looked for.

    All of them where there are times: where a moving board rests is yet to be found.
    """
    most = settings.most_views if times_from_index(calibration) is None else None
    return choose_shots(calibration["views"], most)


def complain_of_symmetry(capture: Path, boards: Sequence[Board], cameras: int) -> None:
    """Refuse boards that look the same upside down.

    One camera may take them either way; several cannot agree on which corner is the first.

    Raises:
        InputError: naming them, if there are several cameras.
    """
    if cameras > 1 and (same := [board.describe() for board in boards if board.half_turn() is not None]):
        expected = "boards that look different upside down, for several cameras"
        hint = (
            "print a ChArUco board, a checkerboard with one number of squares odd and the other even, or an asymmetric "
            "grid of an odd number of rows"
        )
        raise InputError(f"{capture}: calibration.cameras: expected {expected}, found {listed(same)}; {hint}")


def known_beforehand(
    capture: Path, calibration: Mapping[str, Any], sizes: dict[str, tuple[int, int]], settings: CalibrateCameras
) -> RigPriors:
    """Lenses that the capture gives to the cameras of `sizes`, and whether they stay.

    Raises:
        InputError: naming lenses that are not there or cannot be right.
    """
    use = calibration.get("intrinsics", "estimate")
    if use == "estimate":
        return RigPriors()
    complaints = Complaints(capture)
    file = CameraFile.model_validate(calibration["lenses_from"])
    lenses = read_known_lenses(capture, file, calibration.get("lens", BROWN_CONRADY.name), sizes, complaints)
    complaints.raise_if_any()
    sigma = 0.0 if use == "known" else settings.given_lens_error
    return RigPriors([lenses[name] for name in sizes], sigma)


def lens_for(calibration: Mapping[str, Any], settings: CalibrateCameras) -> Lens:
    """Lens model of the index's calibration_cameras.json.

    Raises:
        InputError: if there is no such lens, or none of so many coefficients.
    """
    name = calibration.get("lens", BROWN_CONRADY.name)
    if name not in LENSES:
        raise InputError(f"capture.yaml: lens: expected one of {', '.join(LENSES)}, found {name}")
    lens, number = LENSES[name], settings.distortion
    if number != "auto" and number not in lens.term_counts:
        expected = ", ".join(map(str, lens.term_counts))
        hint = f"set calibrate_cameras.distortion, or auto, for the {name} lenses of this capture"
        raise InputError(f"distortion: expected auto or one of {expected}, found {number}; {hint}")
    return lens
