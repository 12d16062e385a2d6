"""The keys of one board or of several."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from pipeline.capture.schema.camera_schema import BoardCameras, CharucoCameras

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


BOARDS = {"method": "boards", "path": "{camera}/{view:03d}.png"}
CHECKERBOARD = {"squares_x": 10, "squares_y": 7, "square_m": 0.025}
TAGS = {"tags_x": 4, "tags_y": 3, "tag_m": 0.06, "gap_m": 0.02}


def boards_told(**keys):
    with pytest.raises(ValidationError) as caught:
        BoardCameras.model_validate({**BOARDS, **keys})
    return str(caught.value)


def test_boards_of_every_kind_may_be_mixed():
    section = BoardCameras.model_validate({
        **BOARDS, "charuco": [BOARD], "tag_grids": [TAGS], "checkerboards": [CHECKERBOARD],
        "circle_grids": [{"circles_x": 4, "circles_y": 11, "spacing_m": 0.02, "asymmetric": True}],
    })  # fmt: skip
    assert section.tag_grids[0].dictionary == "DICT_APRILTAG_36H11"
    assert section.intrinsics == "estimate"


def test_boards_that_cannot_be_are_refused():
    assert "at least one board under charuco, tag_grids, checkerboards or circle_grids" in boards_told()
    assert "cannot be told apart" in boards_told(checkerboards=[CHECKERBOARD, CHECKERBOARD])
    assert "a square grid looks the same from four sides" in boards_told(
        circle_grids=[{"circles_x": 5, "circles_y": 5, "spacing_m": 0.02}]
    )
    tags = {**TAGS, "dictionary": BOARD["dictionary"]}
    assert "boards that share no marker" in boards_told(charuco=[BOARD], tag_grids=[tags])
    assert "at least 600 markers" in boards_told(tag_grids=[{**TAGS, "tags_x": 30, "tags_y": 20}])


def test_given_lenses_need_a_file_and_a_use():
    lenses = {"format": "cameras_json", "path": "lenses.json"}
    section = BoardCameras.model_validate(
        {**BOARDS, "checkerboards": [CHECKERBOARD], "intrinsics": "known", "lenses_from": lenses}
    )
    assert section.lenses_from.path == "lenses.json"
    needed = boards_told(checkerboards=[CHECKERBOARD], intrinsics="refine")
    assert "a file of lenses, format and path, for intrinsics: refine" in needed
    assert "no lenses for intrinsics: estimate" in boards_told(checkerboards=[CHECKERBOARD], lenses_from=lenses)


def test_a_path_names_images_or_videos():
    keys = {**BOARDS, "checkerboards": [CHECKERBOARD]}
    assert BoardCameras.model_validate({**keys, "path": "boards/{camera}.mp4"}).path == "boards/{camera}.mp4"
    assert "placeholders {camera}" in boards_told(checkerboards=[CHECKERBOARD], path="boards/{camera}/{view}.mp4")
    assert "placeholders" in boards_told(checkerboards=[CHECKERBOARD], path="boards/{camera}.png")
