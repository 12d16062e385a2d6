"""Boards, lens and times that a capture declares, from the index's calibration_cameras.json."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import cv2

from pipeline.base.errors import InputError
from pipeline.calibration.cameras.boards import Board, dictionary_names
from pipeline.calibration.cameras.charuco import CharucoBoard
from pipeline.calibration.cameras.plain_grids import Checkerboard, CircleGrid
from pipeline.calibration.cameras.tag_grids import TagGrid

KINDS: Mapping[str, type[Board]] = {
    "charuco": CharucoBoard,
    "tag_grids": TagGrid,
    "checkerboards": Checkerboard,
    "circle_grids": CircleGrid,
}
"""Class of each list of boards of method `boards`; boards are counted in this order."""


def boards_from_index(calibration: dict[str, Any]) -> list[Board]:
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


def times_from_index(calibration: dict[str, Any]) -> dict[tuple[str, int], float] | None:
    """When each (camera, view) was taken, seconds; None for views whose images were taken at once."""
    views = calibration["views"]
    if not views or any("time_s" not in view for view in views):
        return None
    return {(view["camera"], view["view"]): view["time_s"] for view in views}
