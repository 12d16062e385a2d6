"""The stage from fully lit pictures of painted eyes to a table of gaze."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import pipeline.stages.estimate_gaze as stage
from pipeline.base.errors import InputError
from pipeline.base.exr import write_exr
from pipeline.base.files import write_arrays, write_json, write_table
from pipeline.config.estimate_gaze import EstimateGaze
from pipeline.eyes.iris_gaze import CORNERS, LIDS
from pipeline.geometry.cameras import read_cameras, write_cameras
from pipeline.geometry.texels import write_atlas
from tests.support.avatars.eyeballs import CENTERS, make_atlas, make_eyes
from tests.support.avatars.painted_eyes import LOOKS, RADIUS_M, SHAPE, cameras, painted

LIT = {0: LOOKS[0], 2: LOOKS[1]}
HEAD = Rotation.from_euler("YXZ", [10, 3, -4], degrees=True), np.array([0.01, 0.2, 0.0])

OFF_DEG = 2.0
"""Twice what painted eyes in five pictures are allowed: here there are four, and the template's eyes are spheres of 642
corners, whose radius is 0.3 % off."""


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    root = tmp_path_factory.mktemp("gaze")
    atlas, eyes, head = make_atlas(32), make_eyes(), (HEAD[0].as_matrix(), HEAD[1])
    write_atlas(root / "atlas.safetensors", atlas)
    rows = [(name, vertex) for name, eye in eyes.items() for vertex in eye.vertices]
    write_table(root / "index/eyes.parquet", pd.DataFrame(rows, columns=["eye", "vertex"]))
    columns = {"frame": "int64", "camera": "str", "point": "str", "x": "float64", "y": "float64"}
    none = {name: pd.Series(dtype=kind) for name, kind in columns.items()}
    write_table(root / "index/eye_points.parquet", pd.DataFrame(none))
    facts = {"transfer": "linear", "black_level": 0.0, "downsample_from_sensor": 1.0}
    write_json(root / "index/capture.json", {"images": facts})
    rig = {f"cam{number}": camera for number, camera in enumerate(cameras(head))}
    write_cameras(root / "cameras.json", rig)
    images = []
    for frame, gaze in LIT.items():
        for name, camera in rig.items():
            # A camera sees one of both eyes, or it would take a larger picture.
            write_exr(root / f"{name}_{frame}.exr", painted(camera, head, gaze, CENTERS["eye_l"]))
            images.append((name, frame, f"{name}_{frame}.exr", name == "cam4"))
    table = pd.DataFrame(images, columns=["camera", "frame", "path", "test_camera"])
    write_table(root / "index/images.parquet", table)
    posed = HEAD[0].apply(atlas.rest_vertices) + HEAD[1]
    arrays = {
        "frames": np.arange(4), "vertices": np.repeat(posed[None], 4, 0).astype(np.float32),
        "root_rotation": np.repeat(HEAD[0].as_quat(scalar_first=True)[None], 4, 0).astype(np.float32),
        "root_translation": np.repeat(HEAD[1][None], 4, 0).astype(np.float32),
    }  # fmt: skip
    write_arrays(root / "tracking/0000.safetensors", arrays)
    booked = {
        "frame": range(4),
        "timestamp_s": np.arange(4) / 30,
        "segment": "a",
        "fully_lit": [True, False, True, False],
    }
    write_table(root / "frames.parquet", pd.DataFrame(booked))
    return root


def run(root, **changed):
    paths = {
        "capture": root, "index": root / "index", "atlas": root / "atlas.safetensors", "cameras": root / "cameras.json",
        "tracking": (root / "tracking/0000.safetensors",), "frames": root / "frames.parquet",
        "out": root / "gaze.parquet",
    }  # fmt: skip
    stage.run(**paths | changed)
    return tuple(pd.read_parquet(root / name) for name in ("gaze.parquet", "quality_gaze.parquet"))


def one_eye(root, tmp_path):
    """The same capture, of which only the left eye is listed."""
    for path in root.glob("index/*"):
        (tmp_path / "index").mkdir(exist_ok=True)
        (tmp_path / "index" / path.name).write_bytes(path.read_bytes())
    table = pd.read_parquet(root / "index/eyes.parquet")
    write_table(tmp_path / "index/eyes.parquet", table[table.eye == "eye_l"])
    return tmp_path / "index"


def test_fully_lit_frames_are_estimated_and_others_lie_between(inputs, tmp_path):
    gaze, quality = run(inputs, index=one_eye(inputs, tmp_path))
    assert gaze.frame.tolist() == [0, 1, 2, 3] and gaze.interpolated.tolist() == [False, True, False, True]
    found = gaze[["x", "y", "z"]].to_numpy()
    for frame, look in LIT.items():
        assert np.degrees(np.arccos(found[frame] @ look)) < OFF_DEG
    middle = found[0] + found[2]
    np.testing.assert_allclose(found[1], middle / np.linalg.norm(middle), atol=1e-9)
    np.testing.assert_array_equal(found[3], found[2])
    assert quality.status.tolist() == ["estimated"] * 2 and (quality.views == 4).all()  # one camera is held out
    verdicts = pd.read_csv(inputs / "verdicts_gaze.csv")
    assert verdicts.kind.tolist() == ["gaze"] and "2 of 2 fully lit frames" in verdicts.reason[0]


def detected(root, noise_px=0.25, gaps=None):
    """Points of the left eye as a detector finds them: the middle of its iris, and lids a share of its width apart.

    The held-out camera's are elsewhere.
    """
    random, turn, rows = np.random.default_rng(4), HEAD[0].as_matrix(), []
    away = RADIUS_M * np.cos(SHAPE.limbus_angle)
    for frame, look in LIT.items():
        for name, camera in read_cameras(root / "cameras.json").items():
            places = np.stack([CENTERS["eye_l"], CENTERS["eye_l"] + away * look])
            middle, iris = camera.project(places @ turn.T + HEAD[1])[0] + random.normal(0, noise_px, (2, 2))
            width, gap = np.array([20.0, 0]), np.array([0, 20.0 * (gaps or {}).get(frame, 0.3)])
            points = {"left_pupil": iris + 30 * (name == "cam4")}
            points |= {corner: middle + side * width / 2 for corner, side in zip(CORNERS["left"], (-1, 1), strict=True)}
            for k, (upper, lower) in enumerate(LIDS["left"]):
                at = middle + (k - 0.5) * width / 3
                points |= {upper: at - gap / 2, lower: at + gap / 2}
            rows += [(frame, name, point, *pixel) for point, pixel in points.items()]
    return pd.DataFrame(rows, columns=["frame", "camera", "point", "x", "y"])


def angles_deg(gaze, frames):
    found = gaze.set_index("frame").loc[list(frames), ["x", "y", "z"]].to_numpy()
    return {f: np.degrees(np.arccos(min(1.0, own @ LIT[f]))) for f, own in zip(frames, found, strict=True)}


def test_detected_irises_give_the_gaze_where_pictures_show_none(inputs, tmp_path):
    """Pictures of nothing; the second frame's contours are closed, and it gets the first one's gaze."""
    index = one_eye(inputs, tmp_path)
    write_exr(inputs / "gray.exr", np.full((60, 64, 3), 0.5, np.float32))
    write_table(index / "images.parquet", pd.read_parquet(index / "images.parquet").assign(path="gray.exr"))
    assert run(inputs, index=index)[0].empty
    write_table(index / "eye_points.parquet", detected(inputs, gaps={2: 0.04}))
    gaze, quality = run(inputs, index=index)
    assert quality.status.tolist() == ["estimated", "hidden"] and quality.views[0] == 4
    assert gaze.interpolated.tolist() == [False, True, True, True]
    # A quarter of a pixel of an iris 8 pixels before the eye's centre, in four pictures, is 0.9 degrees.
    assert angles_deg(gaze, [0])[0] < min(3 * quality.sigma_deg[0], 2.7)


def test_detected_irises_and_pixels_are_better_than_either(inputs, tmp_path):
    index = one_eye(inputs, tmp_path)
    alone = run(inputs, index=index)[1]
    write_table(index / "eye_points.parquet", detected(inputs))
    gaze, both = run(inputs, index=index)
    assert (both.sigma_deg < alone.sigma_deg).all()
    assert max(angles_deg(gaze, LIT).values()) < OFF_DEG


def test_fewer_cameras_are_looked_at_if_asked_for(inputs, tmp_path):
    _, quality = run(inputs, index=one_eye(inputs, tmp_path), settings=EstimateGaze(views=3))
    assert (quality.views == 3).all()


def test_without_an_estimate_of_every_eye_there_is_no_gaze(inputs, caplog):
    gaze, quality = run(inputs)
    assert gaze.empty and list(gaze) == list(stage.COLUMNS)
    assert set(quality.status[quality.eye == "eye_r"]) & {"estimated"} == set()
    assert "gaze eye_r: failed: not estimated" in caplog.text


def test_no_fully_lit_frame_is_said(inputs, tmp_path):
    booked = pd.read_parquet(inputs / "frames.parquet").assign(fully_lit=False)
    write_table(tmp_path / "frames.parquet", booked)
    gaze, quality = run(inputs, frames=tmp_path / "frames.parquet")
    assert gaze.empty and quality.empty
    assert "no fully lit frame" in pd.read_csv(inputs / "verdicts_gaze.csv").reason[0]


def test_what_is_no_eye_is_named(inputs, tmp_path):
    index = one_eye(inputs, tmp_path)
    write_table(index / "eyes.parquet", pd.DataFrame({"eye": "eye_l", "vertex": [0, 10**6]}))
    with pytest.raises(InputError, match="eye_l: expected vertices of the atlas, found 1000000"):
        run(inputs, index=index)
    write_table(index / "eyes.parquet", pd.read_parquet(inputs / "index/eyes.parquet").assign(eye="both"))
    with pytest.raises(InputError, match="both: expected vertices on a sphere with a radius of 4 to 30 mm"):
        run(inputs, index=index)
    write_table(index / "eyes.parquet", pd.read_parquet(inputs / "index/eyes.parquet")[:0])
    with pytest.raises(InputError, match=r"see template\.eyes"):
        run(inputs, index=index)
