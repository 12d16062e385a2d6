"""A tiny capture whose tables or template are broken one way at a time: each break must be named."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.support.captures.broken import Break, check_break, manifest, rewritten, text
from tests.support.captures.builder import (
    write_lines,
    write_template,
)


def keypoints(change: Callable[[pd.DataFrame], pd.DataFrame]) -> Break:
    def edit(root: Path) -> None:
        path = root / "keypoints_2d.parquet"
        change(pd.read_parquet(path)).to_parquet(path, index=False)

    return edit


def mislead_template(root: Path) -> None:
    """An accessor of a type that glTF does not have."""
    path = root / "template/template.glb"
    path.write_bytes(path.read_bytes().replace(b"VEC3", b"VEC9"))


def mislead_joints(root: Path) -> None:
    """A vertex that follows the second of two joints now follows the eighth."""
    path = root / "template/template.glb"
    path.write_bytes(path.read_bytes().replace(bytes([0, 0, 1, 0, 0, 1, 0]), bytes([0, 0, 7, 0, 0, 1, 0])))


TABLE_BREAKS: dict[str, tuple[Break, list[str]]] = {
    "no table": (
        lambda root: (root / "cameras.csv").unlink(),
        ["cameras.csv: table: expected the columns", "found", "none"],
    ),
    "empty file": (lambda root: (root / "lights.csv").write_text(""), ["lights.csv: table", "No columns"]),
    "header only": (
        lambda root: write_lines(root / "lights.csv", "light,x,y,z"),
        ["lights.csv: light: expected at least one row"],
    ),
    "missing column": (
        text("cameras.csv", "sensor_height", "high"),
        ["cameras.csv: columns", "no sensor_height among"],
    ),
    "binary csv": (lambda root: (root / "lights.csv").write_bytes(b"\xff\xfe\x00"), ["lights.csv: table"]),
    "text in a number": (
        text("lights.csv", "1.5,0.5", "east,0.5"),
        ["lights.csv: x: expected a finite number, found 'east' in line 3"],
    ),
    "nan position": (
        text("lights.csv", "1.5,0.5", "nan,0.5"),
        ["lights.csv: x: expected a finite number, found 'nan' in line 3"],
    ),
    "infinite position": (text("lights.csv", "1.5,0.5", "inf,0.5"), ["lights.csv: x", "'inf' in line 3"]),
    "one number too many": (
        lambda root: write_lines(root / "lights.csv", "light,x,y,z", "NA,1,2,3", "b,1,2,3,4"),
        ["lights.csv: table", "rows of another number of cells than the 4 of the header: 5 in line 3"],
    ),
    "one number too many in each row": (
        lambda root: write_lines(root / "lights.csv", "light,x,y,z", "a,1,2,3,4", "b,1,2,3,4"),
        ["5 in line 2, 5 in line 3"],
    ),
    "column twice": (
        lambda root: write_lines(root / "lights.csv", "light,x,y,z,x", "a,1,2,3,4"),
        ["lights.csv: table", "columns that are there twice: x"],
    ),
    "number of no float32": (text("lights.csv", "1.5,0.5", "1e300,0.5"), ["lights.csv: x", "'1e300' in line 3"]),
    "milliseconds": (
        rewritten("frames.csv", "frame,timestamp_s,segment", "0,0,a", "1,33.333,a", "2,500,b"),
        ["frames.csv: timestamp_s: expected seconds, 0.0333333 apart", "found 33.333 apart", "write times in seconds"],
    ),
    "certainty beyond measure": (
        keypoints(lambda table: table.assign(confidence=[1e300, *table.confidence[1:]])),
        ["confidence: expected weights of at most 1000, found 1 rows up to 1e+300"],
    ),
    "intensity that float32 cannot hold": (
        text("patterns.csv", "0,A,1.0", "0,A,1e-300"),
        ["patterns.csv: intensity: expected 0, or at least 1.18e-38", "1e-300"],
    ),
    "empty cell": (text("lights.csv", "1.5,0.5", ",0.5"), ["lights.csv: x", "'' in line 3"]),
    "fraction of a pixel": (
        text("cameras.csv", "left,8", "left,8.5"),
        ["cameras.csv: width: expected a whole number", "'8.5'"],
    ),
    "camera that climbs": (
        text("cameras.csv", "left", "../left"),
        ["cameras.csv: camera: expected letters", "'../left' in line 2"],
    ),
    "duplicate camera": (
        text("cameras.csv", "right", "left"),
        ["cameras.csv: camera: expected each once, found repeated: left"],
    ),
    "duplicate frame": (
        text("frames.csv", "1,0.0333", "0,0.0333"),
        ["frames.csv: frame: expected each once, found repeated: 0"],
    ),
    "duplicate light": (text("lights.csv", "B,", "A,"), ["lights.csv: light: expected each once, found repeated: A"]),
    "duplicate pattern row": (
        text("patterns.csv", "0,B", "0,A"),
        ["patterns.csv: frame and light: expected each once", "0 A"],
    ),
    "time stands still": (text("frames.csv", "0.5", "0.03333333333333333"), ["frames.csv: timestamp_s", "frame 2"]),
    "negative frame": (
        text("frames.csv", "2,0.5", "-2,-0.5"),
        ["frames.csv: frame: expected a number of 0 or more", "line 4"],
    ),
    "sensor not a multiple": (
        text("cameras.csv", "left,8,6,16", "left,8,6,17"),
        ["cameras.csv: left: sensor_width x sensor_height: expected 16 x 12", "17 x 12"],
    ),
    "size zero": (
        text("cameras.csv", "left,8", "left,0"),
        ["cameras.csv: width: expected a positive number", "line 2"],
    ),
    "negative intensity": (
        text("patterns.csv", "1,A,2.0", "1,A,-2.0"),
        ["patterns.csv: intensity: expected 0 or more", "line 5"],
    ),
    "negative intensity of a channel": (
        rewritten("patterns.csv", "frame,light,intensity_r,intensity_g,intensity_b", "0,A,1,-2,0", "0,B,1,2,nan"),
        [
            "intensity_g: expected 0 or more, found '-2.0' in line 2",
            "intensity_b: expected a finite number",
        ],
    ),
    "a channel is missing": (
        rewritten("patterns.csv", "frame,light,intensity_r,intensity_b", "0,A,1,1"),
        ["patterns.csv: columns: expected frame, light, intensity_r, intensity_g, intensity_b, found no intensity_g"],
    ),
    "intensities spelled twice": (
        rewritten("patterns.csv", "frame,light,intensity,intensity_r,intensity_g,intensity_b", "0,A,1,1,1,1"),
        ["patterns.csv: columns: expected intensity (white lights), or intensity_r", "found both; keep one"],
    ),
    "no intensity": (
        rewritten("patterns.csv", "frame,light", "0,A"),
        ["patterns.csv: columns: expected frame, light, intensity, found no intensity"],
    ),
    "pattern of unknown light": (
        text("patterns.csv", "1,A", "1,X"),
        ["patterns.csv: light: expected one that", "found X"],
    ),
    "pattern of unknown frame": (
        text("patterns.csv", "1,A", "99,A"),
        ["patterns.csv: frame: expected one that", "found 99"],
    ),
    "keypoint columns": (keypoints(lambda t: t.drop(columns="x")), ["keypoints_2d.parquet: columns", "no x"]),
    "keypoints are text": (
        keypoints(lambda t: t.assign(x="here")),
        ["keypoints_2d.parquet: columns: expected numbers"],
    ),
    "keypoints without names": (
        keypoints(lambda t: t.assign(keypoint=None)),
        ["keypoints_2d.parquet: keypoint: expected a name in each row, found 12 rows without any"],
    ),
    "keypoints nan": (keypoints(lambda t: t.assign(x=np.nan)), ["keypoints_2d.parquet: x: expected finite", "12 rows"]),
    "keypoint unknown": (
        keypoints(lambda t: t.replace({"keypoint": {"hip": "hop"}})),
        ["keypoints_2d.parquet: keypoint: expected one that", "found hop"],
    ),
    "keypoint camera unknown": (
        keypoints(lambda t: t.replace({"camera": {"left": "middle"}})),
        ["keypoints_2d.parquet: camera", "found middle"],
    ),
    "keypoint frame unknown": (
        keypoints(lambda t: t.assign(frame=t["frame"] + 1)),
        ["keypoints_2d.parquet: frame", "found 3"],
    ),
    "keypoint twice": (keypoints(lambda t: pd.concat([t, t[:1]])), ["expected each once, found repeated: 0 left hip"]),
    "keypoints no parquet": (
        lambda root: (root / "keypoints_2d.parquet").write_text("hello"),
        ["expected a parquet table"],
    ),
    "keypoints without places": (
        manifest(lambda m: m["template"].pop("keypoints")),
        ["template.keypoints: expected a csv that says where"],
    ),
    "no template": (
        lambda root: (root / "template/template.glb").unlink(),
        ["template/template.glb: expected a file, found none"],
    ),
    "template of another kind": (
        lambda root: (root / "template/template.glb").write_text("solid"),
        ["glTF 2.0 binary"],
    ),
    "template whose weights are of a joint that is none": (
        mislead_joints,
        ["JOINTS_n: expected joints of the skin, 0 to 1"],
    ),
    "template against the specification": (mislead_template, ["expected a mesh by the glTF 2.0 specification"]),
    "template without triangles": (
        lambda root: write_template(root / "template/template.glb", mode=0),
        ["expected triangles"],
    ),
    "keypoint on no joint": (
        text("template/keypoints.csv", "head,2", "head,0"),
        ["node_index: expected a joint", "'0' in line 3"],
    ),
    "keypoint beyond the mesh": (
        lambda root: write_lines(root / "template/keypoints.csv", "keypoint,vertex", "hip,0", "head,4"),
        ["vertex: expected a vertex of the template, 0 to 3", "'4' in line 3"],
    ),
    "keypoint on both": (
        text("template/keypoints.csv", "keypoint,", "keypoint,vertex,"),
        ["either node_index or vertex"],
    ),
}


@pytest.mark.parametrize("name", TABLE_BREAKS)
def test_table_complaint(name: str, known: Path, tmp_path: Path) -> None:
    check_break(known, tmp_path, *TABLE_BREAKS[name])
