"""A tiny capture whose eyes or gaze are broken one way at a time: each break must be named."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.captures.broken import Break, check_break, manifest
from tests.support.captures.builder import (
    edit_manifest,
    write_lines,
    write_template,
)

BOTH_EYES = ["left,0", "left,1", "left,2", "left,3", "right,4", "right,5", "right,6", "right,7"]


def with_eyes(places: list[str], directions: list[str]) -> Break:
    """A template of two tetrahedra, declared to be eyes."""

    def edit(root: Path) -> None:
        write_template(root / "template/template.glb", copies=2)
        write_lines(root / "template/eyes.csv", "eye,vertex", *places)
        write_lines(root / "gaze.csv", "frame,eye,x,y,z", *directions)
        edit_manifest(root, lambda m: (m.update(gaze="gaze.csv"), m["template"].update(eyes="template/eyes.csv")))

    return edit


def eyes(*rows: str) -> Break:
    return with_eyes(list(rows), ["0,left,0,0,1", "0,right,0,0,1"])


def gaze(*rows: str) -> Break:
    return with_eyes(BOTH_EYES, list(rows))


def regions(*rows: str) -> Break:
    def edit(root: Path) -> None:
        write_lines(root / "template/regions.csv", "region,vertex", *rows)
        edit_manifest(root, lambda m: m["template"].update(regions="template/regions.csv"))

    return edit


EYE_BREAKS: dict[str, tuple[Break, list[str]]] = {
    "no region": (regions(), ["regions.csv: region: expected at least one row, found none; leave the key out"]),
    "region with a strange name": (
        regions("long hair,0"),
        ["regions.csv: region: expected letters, digits, _ - and ., found 'long hair' in line 2"],
    ),
    "region beyond the mesh": (regions("hair,99"), ["regions.csv: vertex: expected a vertex of the template, 0 to"]),
    "vertex twice in a region": (regions("hair,0", "face,0", "hair,0"), ["regions.csv:"]),
    "no table of eyes": (
        manifest(lambda m: m["template"].update(eyes="eyes.csv")),
        ["eyes.csv: table: expected the columns eye, vertex"],
    ),
    "no eye": (eyes(), ["eyes.csv: eye: expected at least one row, found none; leave the key out"]),
    "eye with a strange name": (
        eyes("left.eye,0", *BOTH_EYES[1:]),
        ["eyes.csv: eye: expected letters, digits, _ and -, found 'left.eye' in line 2"],
    ),
    "vertex beyond the mesh": (
        eyes(*BOTH_EYES, "right,8"),
        ["eyes.csv: vertex: expected a vertex of the template, 0 to 7, found '8' in line 10"],
    ),
    "vertex in two eyes": (eyes(*BOTH_EYES, "right,3"), ["eyes.csv: vertex: expected each once, found repeated: 3"]),
    "vertex is missing": (
        eyes(*BOTH_EYES[:7]),
        ["eyes.csv: right: expected every vertex of the faces", "3 faces half in it; not listed: vertices 7"],
    ),
    "eyes that share a part": (
        eyes("left,0", "left,1", "right,2", "right,3"),
        ["eyes.csv: left: expected every vertex", "4 faces half in it", "eyes.csv: right: "],
    ),
    "gaze without eyes": (
        lambda root: (gaze("0,left,0,0,1")(root), edit_manifest(root, lambda m: m["template"].pop("eyes"))),
        ["capture.yaml: template.eyes: expected a csv that says which vertices"],
    ),
    "gaze of an unknown eye": (
        gaze("0,left,0,0,1", "0,third,0,0,1"),
        [
            "gaze.csv: eye: expected one that template.eyes lists, found third",
            "gaze.csv: eye: expected a direction of each eye of template.eyes, found none of right",
        ],
    ),
    "gaze of an unknown frame": (
        gaze("0,left,0,0,1", "0,right,0,0,1", "9,left,0,0,1"),
        ["gaze.csv: frame: expected one that the table of frames lists, found 9"],
    ),
    "gaze twice": (
        gaze("0,left,0,0,1", "0,right,0,0,1", "0,left,0,1,0"),
        ["gaze.csv: frame and eye: expected each once, found repeated: 0 left"],
    ),
    "gaze that is a point": (
        gaze("0,left,0,0,1", "0,right,0.3,0,2"),
        ["gaze.csv: x, y, z: expected a unit direction, found 'length 2.02' in line 3"],
    ),
    "gaze nowhere": (gaze("0,left,0,0,1", "0,right,0,0,0"), ["expected a unit direction, found 'length 0' in line 3"]),
    "gaze that is no number": (
        gaze("0,left,0,0,1", "0,right,nan,0,1"),
        ["gaze.csv: x: expected a finite number, found 'nan' in line 3"],
    ),
}


@pytest.mark.parametrize("name", EYE_BREAKS)
def test_eye_complaint(name: str, known: Path, tmp_path: Path) -> None:
    check_break(known, tmp_path, *EYE_BREAKS[name])
