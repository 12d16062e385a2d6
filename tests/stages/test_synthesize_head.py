"""A very small capture of the head: what differs from the body's, and that the next stages take it."""

import cv2
import numpy as np
import pandas as pd
import pytest
import yaml
from scipy.spatial.transform import Rotation

from pipeline.base.files import read_arrays, read_json
from pipeline.config.synthesize_capture import SynthesizeCapture
from pipeline.config.unwrap_atlas import UnwrapAtlas
from pipeline.geometry.template_file import read_template
from pipeline.stages import index_capture, unwrap_atlas
from tests.support.captures.synthesized import read_truth, synthesize

pytest.importorskip("mitsuba")

SETTINGS = SynthesizeCapture(
    figure="head", framed_height_m=0.36, camera_distance_m=1.2, light_distance_m=1.3, total_intensity=22.0,
    cameras=2, lights=3, frames=2, frames_b=1, fully_lit_every=2, partial_lights_min=1, partial_lights_max=2,
    width=48, height=56, downsample_from_sensor=4, test_cameras=1, test_frames=0, spp_eyes=8,
    vertex_spacing_m=0.009, texture_size=128, spp=4, spp_fully_lit=4, supersampling=1,
    board_squares_x=4, board_squares_y=3, board_square_m=0.04, board_marker_m=0.03, board_poses=14,
    ball_positions=1, ball_cameras=2, ball_radius_m=0.04,
)  # fmt: skip


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return synthesize(tmp_path_factory.mktemp("captures") / "small", SETTINGS)


@pytest.fixture(scope="module")
def truth(capture):
    return read_truth(capture, SETTINGS)


def test_capture_is_valid_and_says_that_it_is_a_head(capture, tmp_path):
    assert yaml.safe_load((capture / "capture.yaml").read_text())["kind"] == "head"
    index_capture.run(capture=capture, out=tmp_path / "index")
    assert read_json(tmp_path / "index/capture.json")["kind"] == "head"


def test_eyes_and_gaze_are_declared_and_true(capture, truth, tmp_path):
    index_capture.run(capture=capture, out=tmp_path / "index")
    assert read_json(tmp_path / "index/capture.json")["template"]["eyes"] == ["left", "right"]
    eyes, gaze = (pd.read_parquet(tmp_path / f"index/{name}.parquet") for name in ("eyes", "gaze"))
    assert not gaze.interpolated.any() and len(gaze) == 2 * SETTINGS.frames
    rest = read_template(capture / "template/template.glb", SETTINGS.scale_to_m).vertices_rest
    _, tracking = truth
    root = Rotation.from_quat(tracking["root_rotation"], scalar_first=True)
    for name, shape in read_json(capture / "truth/eyes.json").items():
        part = eyes.vertex[eyes.eye == name]
        on_eye = np.linalg.norm(rest[part] - shape["center_m"], axis=1)
        ahead = np.array([0, 0, shape["cornea_offset_m"]])
        on_cornea = np.linalg.norm(rest[part] - shape["center_m"] - ahead, axis=1)
        short = np.minimum(np.abs(on_eye - shape["radius_m"]), np.abs(on_cornea - shape["cornea_radius_m"]))
        assert short.max() < 1e-8  # float32 of a tenth of a metre
        looks = gaze[gaze.eye == name].sort_values("frame")[["x", "y", "z"]].to_numpy().copy()
        for frame in range(SETTINGS.frames):
            center = root[frame].apply(shape["center_m"]) + tracking["root_translation"][frame]
            apex = center + (shape["cornea_offset_m"] + shape["cornea_radius_m"]) * root[frame].apply(looks[frame])
            distance = np.linalg.norm(tracking["vertices"][frame, part] - apex, axis=1)
            assert distance.min() < 1e-6  # the vertex that is the pupil's keypoint


def test_template_has_no_joints_and_its_keypoints_are_vertices(capture, truth):
    template = read_template(capture / "template/template.glb", SETTINGS.scale_to_m)
    assert not template.rigged
    _, tracking = truth
    assert tracking["vertices"].shape == (2, *template.vertices_rest.shape)
    keypoints = pd.read_csv(capture / "template/keypoints.csv")
    assert list(keypoints.columns) == ["keypoint", "vertex"] and len(keypoints) == 36
    np.testing.assert_array_equal(tracking["vertices"][:, keypoints.vertex], tracking["keypoints"])


def test_truth_projects_into_the_masks(capture, truth):
    cameras, tracking = truth
    for name, camera in cameras.items():
        for frame in range(2):
            mask = cv2.imread(str(capture / f"masks/{name}/{frame:06d}.png"), cv2.IMREAD_UNCHANGED)
            pixels, _ = camera.project(tracking["vertices"][frame].astype(np.float64))
            rows, columns = np.nonzero(mask)
            # Coverage of half a pixel decides, so the mask's box and the vertices' box agree within a pixel.
            np.testing.assert_allclose([columns.min(), rows.min()], pixels.min(axis=0), atol=1.3)
            np.testing.assert_allclose([columns.max() + 1, rows.max() + 1], pixels.max(axis=0), atol=1.3)


def test_detector_sees_one_side_of_the_head(capture, truth):
    cameras, tracking = truth
    table = pd.read_parquet(capture / "keypoints_2d.parquet")
    names = pd.read_csv(capture / "template/keypoints.csv").keypoint.tolist()
    errors = []
    for (frame, name), rows in table.groupby(["frame", "camera"]):
        pixels, depth = cameras[name].project(tracking["keypoints"][frame].astype(np.float64))
        seen = [names.index(keypoint) for keypoint in rows.keypoint]
        errors.append(np.linalg.norm(rows[["x", "y"]].to_numpy() - pixels[seen], axis=1))
        assert depth[seen].mean() < np.delete(depth, seen).mean()
    assert 0.05 < len(table) / (2 * 2 * 36) < 0.8
    assert np.median(np.concatenate(errors)) < 1.18 * 2 * SETTINGS.keypoint_noise_px


def test_atlas_takes_the_template_with_its_eyes(capture, tmp_path):
    index_capture.run(capture=capture, out=tmp_path / "index")
    unwrap_atlas.run(capture=capture, index=tmp_path / "index", out=tmp_path, settings=UnwrapAtlas(size=64))
    faces = read_arrays(tmp_path / "atlas.safetensors")["face"]
    count = len(read_template(capture / "template/template.glb", 1.0).faces)
    # Two icospheres of 1280 faces each close the list; they are drawn 2.5 times larger than the skin.
    assert (faces >= count - 2560).sum() > 100
