"""The keys of one board or of several."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from pipeline.capture.schema.camera_schema import CharucoCameras

BOARD = {"squares_x": 7, "squares_y": 5, "square_m": 0.12, "marker_m": 0.09, "dictionary": "DICT_5X5_250"}
SECTION = {"method": "charuco", "path": "{camera}/{view:03d}.png"}


def complaints(**keys):
    with pytest.raises(ValidationError) as caught:
        CharucoCameras.model_validate({**SECTION, **keys})
    return {".".join(map(str, e["loc"])): e["msg"] for e in caught.value.errors()}


def test_one_board_or_several():
    one = CharucoCameras.model_validate({**SECTION, **BOARD})
    assert one.boards is None
    assert one.square_m == 0.12
    several = CharucoCameras.model_validate({**SECTION, "boards": [BOARD, {**BOARD, "first_marker": 17}]})
    assert [board.first_marker for board in several.boards] == [0, 17]
    assert several.square_m is None


def test_neither_or_both():
    assert set(complaints()) == set(BOARD)
    assert complaints()["square_m"].endswith("side of a square, metres (or a list of boards)")
    both = complaints(**BOARD, boards=[BOARD])
    assert set(both) == set(BOARD)
    assert both["square_m"].endswith("either boards or the keys of one board")


def test_boards_that_share_a_marker():
    found = complaints(boards=[BOARD, {**BOARD, "dictionary": "DICT_5X5_100", "first_marker": 16}])
    assert "boards 0 and 1 (counted from 0) both have marker 16 of DICT_5X5; set first_marker" in found["boards"]
    # Other dictionaries number their own markers.
    assert CharucoCameras.model_validate({**SECTION, "boards": [BOARD, {**BOARD, "dictionary": "DICT_6X6_250"}]})


def test_no_board_at_all():
    assert "at least one board" in complaints(boards=[])["boards"]


def test_markers_beyond_the_dictionary():
    found = complaints(boards=[{**BOARD, "first_marker": 240}])
    assert "at least 257 markers for this board (this one has 250)" in found["boards.0.dictionary"]


@pytest.mark.parametrize("factor", [100, 1000])
def test_lengths_in_centimetres_or_millimetres(factor):
    found = complaints(**{**BOARD, "square_m": 0.12 * factor, "marker_m": 0.09 * factor})
    assert found["square_m"].endswith("metres, 1 at most (not centimetres or millimetres)")
