"""A table of chart corners, whole and broken, in a tiny capture."""

from __future__ import annotations

import pytest

from pipeline.base.errors import InputError
from pipeline.capture.index.validation import index_folder
from tests.support.captures.builder import build_capture, edit_manifest, write_lines

PATH = "calibration/chart/corners.csv"
WHOLE = ["left,0,1.5,1.5", "left,1,9,2", "left,2,10,8", "left,3,1,7"]


@pytest.fixture
def capture(tmp_path):
    root = build_capture(tmp_path / "tiny", measured=True)
    edit_manifest(root, lambda manifest: manifest["calibration"]["color"].update(corners=PATH))
    return root


def write_corners(capture, *rows):
    write_lines(capture / PATH, "camera,corner,x,y", *rows)


def test_corners_stand_in_the_index_in_their_order(capture):
    write_corners(capture, *reversed(WHOLE))
    content = index_folder(capture).contents["calibration_color"]
    assert content["corners"] == {"left": [[1.5, 1.5], [9.0, 2.0], [10.0, 8.0], [1.0, 7.0]]}


def test_without_the_key_there_are_none(capture):
    edit_manifest(capture, lambda manifest: manifest["calibration"]["color"].pop("corners"))
    assert index_folder(capture).contents["calibration_color"]["corners"] == {}


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ([*WHOLE, "middle,0,1,1"], ["camera: expected one that the table of cameras lists, found middle"]),
        (WHOLE[:3], ["left: corner: expected all of 0 to 3, found no 3"]),
        ([*WHOLE, "left,4,1,1"], ["corner: expected 0, 1, 2 or 3, found '4' in line 6"]),
        ([*WHOLE, WHOLE[0]], ["camera and corner: expected each once, found repeated: left 0"]),
        (["left,0,1.5,high", *WHOLE[1:]], ["y: expected a finite number, found 'high' in line 2"]),
        (
            ["left,0,1,1", "left,1,10,8", "left,2,9,1", "left,3,1,7"],
            ["left: x and y: expected corners 0 to 3", "cross"],
        ),
        (["left,0,1,1", "left,1,2,2", "left,2,3,3", "left,3,4,4"], ["found sides that cross or lie in one line"]),
        (["left,0,1,high", "right,7,1,1"], ["'high' in line 2", "found '7' in line 3", "right: corner"]),
    ],
    ids=["camera", "missing", "fifth", "repeated", "text", "crossing", "line", "all at once"],
)
def test_what_is_wrong_is_named(capture, rows, words):
    write_corners(capture, *rows)
    with pytest.raises(InputError) as caught:
        index_folder(capture)
    for text in words:
        assert f"{PATH}: " in str(caught.value)
        assert text in str(caught.value)


def test_a_missing_table_is_named(capture):
    with pytest.raises(InputError, match=rf"{PATH}: table: expected the columns camera, corner, x, y"):
        index_folder(capture)
