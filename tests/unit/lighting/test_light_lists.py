"""Lists of point lights: what they say, and what is wrong with them."""

from __future__ import annotations

import json

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.lighting.light_lists import read_light_list

HEADER = "light,x,y,z,r,g,b\n"


def written(folder, text: str, name: str = "lights.csv"):
    (folder / name).write_text(text)
    return folder / name


def test_constant_lights(tmp_path) -> None:
    lights = read_light_list(written(tmp_path, HEADER + "key,1,2,3,4,5,6\nfill,-1,0,1,0,0,1\n")).at(7)
    np.testing.assert_array_equal(lights.positions, [[1, 2, 3], [-1, 0, 1]])
    np.testing.assert_array_equal(lights.intensities, [[4, 5, 6], [0, 0, 1]])


def test_keyframes_are_joined_by_straight_lines_and_held(tmp_path) -> None:
    rows = [
        {"light": "a", "picture": 20, "x": 2, "y": 0, "z": 0, "r": 3, "g": 0, "b": 0},
        {"light": "a", "picture": 10, "x": 1, "y": 0, "z": 0, "r": 1, "g": 0, "b": 0},
        {"light": "b", "picture": 0, "x": 5, "y": 0, "z": 0, "r": 1, "g": 1, "b": 1},
    ]
    lights = read_light_list(written(tmp_path, json.dumps(rows), "lights.json"))
    for picture, x, red in [(0, 1, 1), (10, 1, 1), (15, 1.5, 2), (20, 2, 3), (99, 2, 3)]:
        at = lights.at(picture)
        assert sorted(at.positions[:, 0]) == sorted([x, 5])
        assert sorted(at.intensities[:, 0]) == sorted([red, 1])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("light,x,y,z\nkey,1,2,3\n", "missing \\['b', 'g', 'r'\\]"),
        (HEADER, "0 rows"),
        ("light,x,y,z,r,g,b,colour\nkey,1,2,3,4,5,6,red\n", "unknown \\['colour'\\]"),
        (HEADER + "key,1,2,3,4,5,6\nkey,1,2,3,4,5,6\n", "one row for picture 0"),
        (HEADER + "a,far,2,3,4,5,6\nb,1,2,3,4,-5,6\n", "(?s)2 problems.*finite numbers.*0 or more"),
        (HEADER + "key,1,2,3,4,5,6,7\n", "number of cells than the 7 of the header: 8 in line 2"),
        (HEADER + "key,1,2,3,4,5,6,\n", "number of cells than the 7 of the header: 8 in line 2"),
        (HEADER + "key,1,2,3,4,5\n", "number of cells than the 7 of the header: 6 in line 2"),
        (HEADER + ",1,2,3,4,5,6\n", "row 1: expected a name"),
        (HEADER + "key,1,2,3,1e300,5,6\n", "finite numbers"),
        ("light,picture,x,y,z,r,g,b\nkey,nan,1,2,3,4,5,6\n", "finite numbers"),
        ("light,picture,x,y,z,r,g,b\nkey,1,1,2,3,4,5,6\nkey,1.0,1,2,3,4,5,6\n", "one row for picture 1"),
    ],
)
def test_what_is_wrong_is_said(tmp_path, text, said) -> None:
    with pytest.raises(InputError, match=said):
        read_light_list(written(tmp_path, text))


@pytest.mark.parametrize("name", ["NA", "nan", "None", "null", "7"])
def test_light_is_called_what_it_is_called(tmp_path, name) -> None:
    """pandas takes some names for numbers that are missing, and drops their rows."""
    assert list(read_light_list(written(tmp_path, HEADER + f"{name},1,2,3,4,5,6\n")).keys) == [name]
    row = {"light": name, "x": 1, "y": 2, "z": 3, "r": 4, "g": 5, "b": 6}
    assert list(read_light_list(written(tmp_path, json.dumps([row]), "lights.json")).keys) == [name]


def test_lights_of_a_list_without_a_name_are_refused(tmp_path) -> None:
    row = {"light": None, "x": 1, "y": 2, "z": 3, "r": 4, "g": 5, "b": 6}
    with pytest.raises(InputError, match="row 1: expected a name"):
        read_light_list(written(tmp_path, json.dumps([row]), "lights.json"))


def test_missing_file_and_wrong_json_are_said(tmp_path) -> None:
    with pytest.raises(InputError, match="lights"):
        read_light_list(tmp_path / "absent.csv")
    with pytest.raises(InputError, match="list of objects"):
        read_light_list(written(tmp_path, '{"a": 1}', "lights.json"))
