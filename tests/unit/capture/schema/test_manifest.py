"""Whatever stands in capture.yaml: it is read, or it is a complaint that names the key; never a traceback."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from pipeline.base.errors import Complaints
from pipeline.capture.schema.capture_yaml import Capture
from pipeline.capture.schema.manifest import read_manifest
from tests.support.captures.builder import MANIFEST, MEASURED

JUNK = (
    None,
    [],
    {},
    3,
    -1,
    0,
    "x",
    "",
    True,
    math.nan,
    1.5,
    [None],
    {"method": "known"},
    {"method": None},
    {"method": []},
)


def places(section: dict, above: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    for key, value in section.items():
        yield (*above, key)
        if isinstance(value, dict):
            yield from places(value, (*above, key))


def read(content: dict, root: Path) -> tuple[Capture, Complaints]:
    (root / "capture.yaml").write_text(yaml.dump(content, Dumper=getattr(yaml, "CSafeDumper", yaml.SafeDumper)))
    complaints = Complaints(root)
    return read_manifest(root, complaints), complaints


WHOLE = MANIFEST | {"calibration": MEASURED}


@pytest.mark.parametrize("place", list(places(WHOLE)), ids=".".join)
def test_junk_is_a_complaint_at_its_place_or_legal(place: tuple[str, ...], tmp_path: Path) -> None:
    complained = 0
    for junk in JUNK:
        content = copy.deepcopy(WHOLE)
        section = content
        for key in place[:-1]:
            section = section[key]
        section[place[-1]] = junk
        _, complaints = read(content, tmp_path)
        complained += bool(complaints)
        for message in complaints.messages:
            # The one rule across keys: a longer marker or a smaller dictionary is blamed on the later key.
            assert message.startswith(f"capture.yaml: {'.'.join(place[:2])}"), message
    assert complained >= len(JUNK) // 2


def test_valid_sections_survive_invalid_neighbours(tmp_path: Path) -> None:
    content = copy.deepcopy(WHOLE)
    content["images"]["transfer"] = "log"
    content["calibration"]["lights"]["radius_m"] = -1
    del content["splits"]
    manifest, complaints = read(content, tmp_path)
    assert len(complaints.messages) == 3
    assert manifest.images is None
    assert manifest.splits is None
    assert manifest.calibration.lights is None
    assert manifest.calibration.cameras.squares_x == 7
    assert manifest.calibration.color.method == "chart"
    assert manifest.masks.path == MANIFEST["masks"]["path"]


def test_every_key_of_the_format_is_described() -> None:
    """Complaints quote the description of a key that is missing."""

    schema = Capture.model_json_schema()
    models = {"Capture": schema, **schema["$defs"]}
    fields = {(name, key): field for name, model in models.items() for key, field in model["properties"].items()}
    assert len(fields) > 40
    assert [place for place, field in fields.items() if not field.get("description")] == []


def test_a_key_of_a_list_entry_is_named_like_any_other(tmp_path: Path) -> None:
    board = {"squares_x": 7, "squares_y": 5, "square_m": 0.12, "marker_m": 0.09, "dictionary": "DICT_5X5_250"}
    content = copy.deepcopy(WHOLE)
    content["calibration"]["cameras"] = {"method": "charuco", "path": "b/{camera}/{view}.png", "boards": [board, board]}
    content["calibration"]["cameras"]["boards"][1] = {k: v for k, v in board.items() if k != "square_m"}
    _, complaints = read(content, tmp_path)
    assert len(complaints.messages) == 1
    assert "calibration.cameras.boards[1].square_m: expected side of a square" in complaints.messages[0]
    assert "no such key" in complaints.messages[0]
