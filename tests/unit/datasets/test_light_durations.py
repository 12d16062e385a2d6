"""Light patterns as lists of durations: what they add up to, and what is wrong in them."""

from __future__ import annotations

import json

import pytest

from pipeline.base.errors import InputError
from pipeline.datasets.light_durations import intensities, read_durations, read_lights, read_pattern_of_frames


def written(path, content):
    path.write_text(json.dumps(content))
    return path


def patterns(*pairs):
    return {"light_patterns": [{"light_index_durations": list(one)} for one in pairs]}


def test_repeated_lights_add_up_and_dark_ones_are_left_out(tmp_path):
    path = written(tmp_path / "p.json", patterns([[0, 100], [2, 50], [0, 25]], [[1, 0], [2, 200]]))
    found = read_durations(path, "light_patterns", 3)
    assert found == [{0: 125.0, 2: 50.0}, {1: 0.0, 2: 200.0}]
    table = intensities([7, 8], {7: 0, 8: 1}, found, 100.0, 1.5)
    assert list(table.itertuples(index=False, name=None)) == [(7, "L000", 1.25), (7, "L002", 0.5), (8, "L002", 3.0)]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (patterns([[3, 10]]), "expected lights 0 to 2, on for 0 or longer, found light 3"),
        (patterns([[0, -1]]), "on for 0 or longer"),
        ({"light_patterns": [{}]}, "expected light_index_durations"),
        ({"light_pattern": []}, "light_patterns: expected this key, found the keys light_pattern"),
    ],
)
def test_wrong_patterns_are_named(tmp_path, content, words):
    with pytest.raises(InputError, match=words):
        read_durations(written(tmp_path / "p.json", content), "light_patterns", 3)


@pytest.mark.parametrize(("content", "words"), [([[0, 9]], "patterns 0 to 1"), ([[0, 0], [0, 1]], "two for frame 0")])
def test_wrong_frames_are_named(tmp_path, content, words):
    with pytest.raises(InputError, match=words):
        read_pattern_of_frames(written(tmp_path / "f.json", content), 2)


def test_positions_that_are_no_points_are_refused(tmp_path):
    with pytest.raises(InputError, match="rows of three finite numbers"):
        read_lights(written(tmp_path / "l.json", {"light_positions": [[0, 0], [1, 1, 1]]}), 1.0)
