"""A tiny capture broken one way at a time: each break must be named, with what was expected and found."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pipeline.base.errors import InputError
from pipeline.capture.validation import index_folder
from tests.capture_builder import (
    HEIGHT,
    WIDTH,
    build_capture,
    edit_manifest,
    replace_text,
    save,
    save_exr,
    truncate,
    write_lines,
    write_template,
)


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_capture(tmp_path_factory.mktemp("known") / "tiny")


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_capture(tmp_path_factory.mktemp("measured") / "tiny", measured=True)


def complaints_of(capture: Path) -> str:
    with pytest.raises(InputError) as caught:
        index_folder(capture)
    return str(caught.value)


Break = Callable[[Path], object]


def manifest(change: Callable[[dict], object]) -> Break:
    return lambda root: edit_manifest(root, change)


def text(name: str, old: str, new: str) -> Break:
    return lambda root: replace_text(root / name, old, new)


def rewritten(name: str, *lines: str) -> Break:
    return lambda root: write_lines(root / name, *lines)


def keypoints(change: Callable[[pd.DataFrame], pd.DataFrame]) -> Break:
    def edit(root: Path) -> None:
        path = root / "keypoints_2d.parquet"
        change(pd.read_parquet(path)).to_parquet(path, index=False)

    return edit


def known_cameras(change: Callable[[dict], object]) -> Break:
    def edit(root: Path) -> None:
        path = root / "calibration/cameras.json"
        content = json.loads(path.read_text())
        change(content["cameras"])
        path.write_text(json.dumps(content))

    return edit


def link_outside(root: Path) -> None:
    outside = root.parent / "elsewhere.exr"
    (root / "images/left/000001.exr").rename(outside)
    (root / "images/left/000001.exr").symlink_to(outside)


def mislead_template(root: Path) -> None:
    """An accessor of a type that glTF does not have."""
    path = root / "template/template.glb"
    path.write_bytes(path.read_bytes().replace(b"VEC3", b"VEC9"))


def nan_pixels(root: Path) -> None:
    image = np.full((HEIGHT, WIDTH, 3), 0.5)
    image[0, 0, 1], image[2, 3, 0] = np.nan, np.inf
    save_exr(root / "images/left/000002.exr", image)


MANIFEST_BREAKS: dict[str, tuple[Break, list[str]]] = {
    "unknown test pattern": (
        manifest(lambda m: m["splits"].update(test_patterns=[0, 9])),
        ["splits.test_patterns: expected one that the table of frames lists, found 9"],
    ),
    "missing key": (manifest(lambda m: m.pop("fps")), ["fps: expected frames per second, found no such key"]),
    "missing section": (manifest(lambda m: m.pop("splits")), ["splits: expected a section with the keys test_cameras"]),
    "unknown key with hint": (
        manifest(lambda m: m["images"].update(transfre="linear")),
        ["images.transfre", "unknown key; did you mean transfer?"],
    ),
    "unknown key": (manifest(lambda m: m.update(zebra=1)), ["capture.yaml: zebra: ", "an unknown key; remove it"]),
    "text for a number": (manifest(lambda m: m.update(fps="fast")), ["fps: expected a number, found text 'fast'"]),
    "number for a name": (
        manifest(lambda m: m["splits"].update(test_segments=[3])),
        ["splits.test_segments[0]: expected text", "found a number 3"],
    ),
    "true for a number": (
        manifest(lambda m: m["images"].update(black_level=True)),
        ["images.black_level: expected a number"],
    ),
    "fps zero": (manifest(lambda m: m.update(fps=0)), ["fps: expected greater than 0"]),
    "other format": (
        manifest(lambda m: m.update(format="lightstage-capture/2")),
        ["format: expected 'lightstage-capture/1'"],
    ),
    "subject with a space": (
        manifest(lambda m: m.update(subject="my subject")),
        ["subject: expected", "letters, digits"],
    ),
    "subject with a newline": (
        manifest(lambda m: m.update(subject="tiny\n")),
        ["subject: expected", "letters, digits"],
    ),
    "kind": (manifest(lambda m: m.update(kind="cat")), ["kind: expected 'body' or 'head', found text 'cat'"]),
    "millimetres": (manifest(lambda m: m.update(units="mm")), ["units: expected 'm'", "convert lights.csv to metres"]),
    "z up": (manifest(lambda m: m.update(up="+z")), ["up: expected '+y'", "rotate the world"]),
    "absolute path": (
        manifest(lambda m: m.update(lights="/lights.csv")),
        ["lights: expected a path relative to the capture"],
    ),
    "path that climbs": (
        manifest(lambda m: m["template"].update(mesh="../template.glb")),
        ["template.mesh: expected a path that stays inside"],
    ),
    "pattern without frame": (
        manifest(lambda m: m["images"].update(path="images/{camera}.exr")),
        ["images.path", "placeholders {camera}, {frame:06d}"],
    ),
    "pattern with attribute": (
        manifest(lambda m: m["masks"].update(path="{camera.__class__}{frame}.png")),
        ["masks.path", "nothing else in braces"],
    ),
    "pattern with open brace": (
        manifest(lambda m: m["images"].update(path="{camera/{frame}.exr")),
        ["images.path", "pattern"],
    ),
    "image suffix": (
        manifest(lambda m: m["images"].update(path="{camera}/{frame}.jpg")),
        ["images.path: expected a path that ends in .exr"],
    ),
    "unknown method": (
        manifest(lambda m: m["calibration"]["lights"].update(method="ball")),
        ["calibration.lights.method: expected one of 'mirror_ball', 'known', found 'ball'"],
    ),
    "no method": (
        manifest(lambda m: m["calibration"]["color"].pop("method")),
        ["calibration.color.method: expected one of chart, none"],
    ),
    "section that is a list": (
        manifest(lambda m: m.update(template=[1])),
        ["template: expected a section of keys, found a list"],
    ),
    "unknown test camera": (
        manifest(lambda m: m["splits"].update(test_cameras=["middle"])),
        ["splits.test_cameras: expected one that", "middle"],
    ),
    "unknown test frame": (
        manifest(lambda m: m["splits"].update(test_frames=[77])),
        ["splits.test_frames", "found 77"],
    ),
    "unknown test segment": (
        manifest(lambda m: m["splits"].update(test_segments=["z"])),
        ["splits.test_segments", "found z"],
    ),
    "all cameras test": (
        manifest(lambda m: m["splits"].update(test_cameras=["left", "right"])),
        ["splits: expected some images that no split"],
    ),
    "all frames test": (
        manifest(lambda m: m["splits"].update(test_segments=["a", "b"])),
        ["splits: expected some images that no split"],
    ),
}

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


EYE_BREAKS: dict[str, tuple[Break, list[str]]] = {
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

IMAGE_BREAKS: dict[str, tuple[Break, list[str]]] = {
    "no image of a camera": (
        lambda root: shutil.rmtree(root / "images/right"),
        ["images: right: expected one for each of 3 frames, found none at all"],
    ),
    "an image missing": (
        lambda root: (root / "images/left/000001.exr").unlink(),
        ["images: left: expected one for each frame, found 1 of 3 images missing: 1"],
    ),
    "a mask missing": (
        lambda root: (root / "masks/left/000001.png").unlink(),
        ["masks: left", "1 of 3 masks missing: 1"],
    ),
    "truncated image": (
        lambda root: truncate(root / "images/left/000001.exr"),
        ["images/left/000001.exr: expected a whole OpenEXR image"],
    ),
    "empty image": (
        lambda root: truncate(root / "images/left/000001.exr", 0),
        ["images/left/000001.exr: expected a whole OpenEXR"],
    ),
    "truncated mask": (
        lambda root: truncate(root / "masks/left/000001.png"),
        ["masks/left/000001.png: expected a whole image"],
    ),
    "image size": (
        lambda root: save_exr(root / "images/left/000001.exr", np.zeros((3, 4, 3))),
        ["images/left/000001.exr: left: size: expected 8 x 6 pixels", "found 4 x 3"],
    ),
    "mask size": (
        lambda root: save(root / "masks/left/000001.png", np.zeros((3, 4), np.uint8)),
        ["masks/left/000001.png: left: size", "found 4 x 3"],
    ),
    "channel names": (
        lambda root: save_exr(root / "images/left/000001.exr", np.zeros((6, 8, 3)), "XYZ"),
        ["channels R, G, B, found X, Y, Z"],
    ),
    "one channel": (
        lambda root: save_exr(root / "images/left/000001.exr", np.zeros((6, 8, 1)), "Y"),
        ["three channels R, G, B, found 1 channel"],
    ),
    "mask of 16 bit": (
        lambda root: save(root / "masks/left/000001.png", np.zeros((6, 8), np.uint16)),
        ["expected a mask of one 8-bit channel", "uint16"],
    ),
    "mask in colour": (
        lambda root: save(root / "masks/left/000001.png", np.zeros((6, 8, 3), np.uint8)),
        ["found 3 channels"],
    ),
    "mask of zero and one": (
        lambda root: save(root / "masks/left/000001.png", np.eye(6, 8, dtype=np.uint8)),
        ["expected 0 to 255, 255 = subject"],
    ),
    "nan and inf": (
        nan_pixels,
        ["images/left/000002.exr: left: pixels: expected finite numbers, found 2 of 48 pixels"],
    ),
    "link that leaves": (link_outside, ["images/left/000001.exr: expected a file inside the capture", "elsewhere.exr"]),
}

KNOWN_BREAKS: dict[str, tuple[Break, list[str]]] = {
    "no cameras.json": (
        lambda root: (root / "calibration/cameras.json").unlink(),
        ["calibration/cameras.json: expected a file"],
    ),
    "no json": (
        lambda root: (root / "calibration/cameras.json").write_text("{"),
        ["calibration/cameras.json: expected a JSON"],
    ),
    "camera left out": (known_cameras(lambda c: c.pop("left")), ["calibration/cameras.json: left", "found no entry"]),
    "image resolution": (
        known_cameras(lambda c: c["left"].update(width=8)),
        ["left: width x height: expected the sensor's 16 x 12"],
    ),
    "mirrored": (
        known_cameras(lambda c: c["left"].update(R=np.diag([1.0, 1, -1]).tolist())),
        ["left: R: expected a rotation", "mirrored"],
    ),
    "scaled": (
        known_cameras(lambda c: c["left"].update(R=np.diag([2.0, 2, 2]).tolist())),
        ["left: R: expected a rotation"],
    ),
    "distortion of four": (known_cameras(lambda c: c["left"].update(dist=[0.0] * 4)), ["camera left: dist"]),
    "two known cameras at once": (
        known_cameras(lambda c: (c["left"].update(width=8), c.pop("right"))),
        ["cameras.json: left: width x height", "cameras.json: right: expected every camera"],
    ),
    "unknown format of cameras": (
        manifest(lambda m: m["calibration"]["cameras"].update(format="opencv")),
        ["calibration.cameras.format: expected 'cameras_json', 'colmap' or 'nerfstudio', found text 'opencv'"],
    ),
    "folder without its format": (
        manifest(lambda m: m["calibration"]["cameras"].update(path="calibration/sparse")),
        ["calibration.cameras.path: expected a path that ends in .json"],
    ),
    "no COLMAP model": (
        manifest(lambda m: m["calibration"]["cameras"].update(path="calibration/sparse", format="colmap")),
        ["calibration/sparse: expected the folder of a COLMAP model, found none"],
    ),
    "nerfstudio without frames": (
        manifest(lambda m: m["calibration"]["cameras"].update(format="nerfstudio")),
        ["calibration/cameras.json: frames: expected a list"],
    ),
}

MEASURED_BREAKS: dict[str, tuple[Break, list[str]]] = {
    "keys of another method": (
        manifest(lambda m: m["calibration"]["cameras"].update(radius_m=1)),
        ["calibration.cameras.radius_m", "an unknown key"],
    ),
    "key of the method missing": (
        manifest(lambda m: m["calibration"]["cameras"].pop("square_m")),
        ["calibration.cameras.square_m: expected side of a square"],
    ),
    "marker larger than square": (
        manifest(lambda m: m["calibration"]["cameras"].update(marker_m=0.2)),
        ["calibration.cameras.marker_m: expected less than"],
    ),
    "unknown dictionary": (
        manifest(lambda m: m["calibration"]["cameras"].update(dictionary="DICT_9X9")),
        ["calibration.cameras.dictionary", "cv2.aruco"],
    ),
    "small dictionary": (
        manifest(lambda m: m["calibration"]["cameras"].update(dictionary="DICT_5X5_50", squares_x=20, squares_y=20)),
        ["calibration.cameras.dictionary", "at least 200 markers"],
    ),
    "camera without a view": (
        lambda root: shutil.rmtree(root / "calibration/charuco/left"),
        ["at least one view of the board per camera, found none for left"],
    ),
    "view of unknown camera": (
        lambda root: shutil.copytree(root / "calibration/charuco/left", root / "calibration/charuco/middle"),
        ["camera", "found middle"],
    ),
    "view at image size": (
        lambda root: save(root / "calibration/charuco/left/003.png", np.zeros((6, 8), np.uint8)),
        ["left/003.png: left: size: expected 16 x 12"],
    ),
    "truncated view": (
        lambda root: truncate(root / "calibration/charuco/left/003.png"),
        ["charuco/left/003.png: expected a whole image"],
    ),
    "no silhouette": (
        lambda root: (root / "calibration/ball/low/left/silhouette.png").unlink(),
        ["silhouette: expected one per ball", "none for low left"],
    ),
    "unknown light": (
        lambda root: (root / "calibration/ball/low/left/A.png").rename(root / "calibration/ball/low/left/Q.png"),
        ["light", "found Q"],
    ),
    "no ball images": (
        lambda root: shutil.rmtree(root / "calibration/ball"),
        ["expected images of the mirror ball, found none"],
    ),
    "one sighting": (
        lambda root: shutil.rmtree(root / "calibration/ball/low/left"),
        ["at least 2 pairs of ball position and camera"],
    ),
    "no chart image": (
        lambda root: (root / "calibration/chart/left.exr").unlink(),
        ["an image of the chart per camera, found none for left"],
    ),
    "patch missing": (
        lambda root: write_lines(root / "calibration/chart/chart.csv", "patch,r,g,b", "1,0.1,0.1,0.1"),
        ["patch: expected 1 to 24"],
    ),
    "stage frame open": (
        manifest(lambda m: m["calibration"].update(lights={"method": "known"})),
        ["calibration.lights.method: expected mirror_ball", "frame of their own"],
    ),
}


def _check_break(capture: Path, tmp_path: Path, how: Break, expected: list[str]) -> None:
    broken = shutil.copytree(capture, tmp_path / "capture", symlinks=True)
    how(broken)
    message = complaints_of(broken)
    for words in expected:
        assert words in message, message


@pytest.mark.parametrize("name", MANIFEST_BREAKS)
def test_manifest_complaint(name: str, known: Path, tmp_path: Path) -> None:
    _check_break(known, tmp_path, *MANIFEST_BREAKS[name])


@pytest.mark.parametrize("name", TABLE_BREAKS)
def test_table_complaint(name: str, known: Path, tmp_path: Path) -> None:
    _check_break(known, tmp_path, *TABLE_BREAKS[name])


@pytest.mark.parametrize("name", EYE_BREAKS)
def test_eye_complaint(name: str, known: Path, tmp_path: Path) -> None:
    _check_break(known, tmp_path, *EYE_BREAKS[name])


@pytest.mark.parametrize("name", IMAGE_BREAKS)
def test_image_complaint(name: str, known: Path, tmp_path: Path) -> None:
    _check_break(known, tmp_path, *IMAGE_BREAKS[name])


@pytest.mark.parametrize("name", KNOWN_BREAKS)
def test_known_calibration_complaint(name: str, known: Path, tmp_path: Path) -> None:
    _check_break(known, tmp_path, *KNOWN_BREAKS[name])


@pytest.mark.parametrize("name", MEASURED_BREAKS)
def test_measured_calibration_complaint(name: str, measured: Path, tmp_path: Path) -> None:
    _check_break(measured, tmp_path, *MEASURED_BREAKS[name])


def test_no_capture_folder(tmp_path: Path) -> None:
    assert "expected a capture folder, found none" in complaints_of(tmp_path / "nowhere")


def test_no_manifest(tmp_path: Path) -> None:
    (tmp_path / "capture").mkdir()
    assert "capture.yaml: expected the capture's description" in complaints_of(tmp_path / "capture")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("images: [", "expected valid YAML"),
        ("subject: a\nsubject: b\n", "the key 'subject' is there twice"),
        ("subject: !!python/object:os.system a", "expected valid YAML"),
        ("- a\n- b\n", "found a list"),
        ("", "found nothing"),
    ],
)
def test_manifest_is_no_mapping(content: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "capture").mkdir()
    (tmp_path / "capture/capture.yaml").write_text(content)
    assert words in complaints_of(tmp_path / "capture")
