"""A capture in the layouts of other programs, read back by their readers and compared with what was written."""

from __future__ import annotations

import json
import shutil
import zipfile
from dataclasses import replace

import cv2
import numpy as np
import pandas as pd
import pycolmap
import pytest
import yaml

from pipeline.base.errors import InputError
from pipeline.base.files import read_arrays, write_json
from pipeline.capture.images import ImageSource
from pipeline.config.export_capture import ExportCapture
from pipeline.effects.scene_evidence import read_colors
from pipeline.geometry.cameras import read_cameras, write_cameras
from pipeline.geometry.lenses import FISHEYE
from pipeline.stages import import_capture
from pipeline.stages.export_capture import run
from tests.support.datasets.goliath_layout import WHITE_BALANCE, true_head, write_goliath
from tests.support.datasets.imported import import_set
from tests.support.rigs.camera_files import read

SAME_PX = 1e-9
"""Float64 through text and quaternions: 1e-15 of some thousand pixels, with room for their conversions."""

SAME_M = 2e-6
"""Positions in float32 millimetres, up to 1 m from the head: 6e-8 of it, and as much in float32 meshes of tracking."""

HALF_COUNT = 0.5 / 255 + 1e-6
"""In sRGB, of images in 8 bits."""

LOSSY_COUNTS = 2 + 1e-4
"""Of 255, by which AVIF at its highest quality changes a pixel: rounding to YUV and back."""

DURATION_STEP = 0.5 / 5555
"""Of intensities, which become whole durations."""


@pytest.fixture(scope="module")
def imported(tmp_path_factory):
    """Folders of a capture of a head, and of its results."""
    shipped = write_goliath(tmp_path_factory.mktemp("set"), true_head())
    return import_set("goliath", shipped, tmp_path_factory.mktemp("imported"))


def inputs(imported):
    capture, results = imported
    calibration = results / "calibration"
    return {
        "subject": "someone", "capture": capture, "index": results / "index", "cameras": calibration / "cameras.json",
        "color": calibration / "color.json", "lights": calibration / "lights.parquet",
        "patterns": results / "index/patterns.parquet", "tracking": (results / "tracking/0000.safetensors",),
    }  # fmt: skip


@pytest.fixture(scope="module")
def exported(imported, tmp_path_factory):
    """Layout -> folder."""
    folders = {layout: tmp_path_factory.mktemp("exports") / layout for layout in ("colmap", "nerfstudio", "goliath")}
    for layout, folder in folders.items():
        run(**inputs(imported), layout=layout, out=folder)
    return folders


def true_cameras(imported):
    """At the resolution of the images."""
    cameras = read_cameras(imported[1] / "calibration/cameras.json")
    return {name: camera.downsampled(2) for name, camera in cameras.items()}


def points_before(camera):
    """50 points about a metre in front of a camera, in the world."""
    in_camera = np.random.default_rng(0).uniform([-0.2, -0.2, 0.8], [0.2, 0.2, 1.2], (50, 3))
    return camera.center + in_camera @ camera.R


def recorded(imported, row):
    """Linear light of an image in corrected colours, and its mask or None."""
    capture, results = imported
    source = ImageSource.from_index(capture, json.loads((results / "index/capture.json").read_text())["images"])
    image = source.read(row.path, None)
    matrix = read_colors(results / "calibration/color.json")[str(row.camera)]
    return image @ matrix.T, None if pd.isna(row.mask_path) else source.read_mask(row.mask_path, image.shape)


def some_images(imported, count=5):
    images = pd.read_parquet(imported[1] / "index/images.parquet")
    return images.iloc[np.linspace(0, len(images) - 1, count).astype(int)].itertuples()


def srgb(linear):
    clipped = np.clip(linear, 0, 1)
    return np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)


@pytest.mark.parametrize(("layout", "path"), [("colmap", "sparse/0"), ("nerfstudio", "transforms.json")])
def test_cameras_come_back_the_same(imported, exported, layout, path):
    known = true_cameras(imported)
    sizes = {name: (camera.width, camera.height) for name, camera in known.items()}
    cameras, complaints = read(exported[layout], sizes, format="auto", path=path)
    assert not complaints
    assert set(cameras) == set(known)
    for name, camera in known.items():
        points = points_before(camera)
        assert np.abs(cameras[name].project(points)[0] - camera.project(points)[0]).max() < SAME_PX


def test_colmap_reads_one_rig_with_a_frame_per_moment(imported, exported):
    model = pycolmap.Reconstruction(exported["colmap"] / "sparse/0")
    images, known = pd.read_parquet(imported[1] / "index/images.parquet"), true_cameras(imported)
    assert (model.num_rigs(), model.num_cameras()) == (1, len(known))
    assert (model.num_reg_frames(), model.num_images()) == (images.frame.nunique(), len(images))
    assert sorted(image.name for image in model.images.values()) == sorted(
        f"{row.camera}/{row.frame:06d}.png" for row in images.itertuples()
    )
    for image in model.images.values():
        camera = known[image.name.split("/")[0]]
        points, pose = points_before(camera), image.cam_from_world()
        pixels = image.camera.img_from_cam(points @ pose.rotation.matrix().T + pose.translation)
        assert np.abs(pixels - camera.project(points)[0]).max() < SAME_PX
    for frame in model.frames.values():
        moments = {image.name.split("/")[1] for image in model.images.values() if image.frame_id == frame.frame_id}
        assert len(moments) == 1


def test_nerfstudio_poses_look_along_minus_z(imported, exported):
    content = json.loads((exported["nerfstudio"] / "transforms.json").read_text())
    known = true_cameras(imported)
    for frame in content["frames"]:
        camera = known[frame["file_path"].split("/")[1]]
        pose, points = np.array(frame["transform_matrix"]), points_before(camera)
        x, y, z = pose[:3, :3].T @ (points - pose[:3, 3]).T
        slopes = np.stack([x / -z, -y / -z, np.ones_like(x)], 1)
        K = np.array([[frame["fl_x"], 0, frame["cx"]], [0, frame["fl_y"], frame["cy"]], [0, 0, 1]])
        dist = np.array([frame[term] for term in ("k1", "k2", "p1", "p2", "k3")])
        pixels = cv2.projectPoints(slopes, np.zeros(3), np.zeros(3), K, dist)[0][:, 0]
        assert np.abs(pixels - camera.project(points)[0]).max() < SAME_PX


@pytest.mark.parametrize(("layout", "mask"), [("colmap", "{}.png"), ("nerfstudio", "{}")])
def test_images_and_masks_come_back_the_same(imported, exported, layout, mask):
    for row in some_images(imported):
        linear, subject = recorded(imported, row)
        name = f"{row.camera}/{row.frame:06d}.png"
        stored = cv2.imread(str(exported[layout] / "images" / name))[..., ::-1]
        assert np.abs(stored / 255 - srgb(linear)).max() < HALF_COUNT
        path = exported[layout] / "masks" / mask.format(name)
        assert path.is_file() == (subject is not None)
        if subject is not None:
            np.testing.assert_array_equal(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), subject)


@pytest.fixture(scope="module")
def again(exported, tmp_path_factory):
    """Folders of the capture that the Goliath layout is read as, and of its results."""
    return import_set("goliath", exported["goliath"] / "someone--Head", tmp_path_factory.mktemp("again"))


def test_goliath_layout_is_read_as_the_same_capture(imported, again):
    for name, camera in read_cameras(imported[1] / "calibration/cameras.json").items():
        other = read_cameras(again[1] / "calibration/cameras.json")[name]
        points = points_before(camera)
        assert np.abs(other.project(points)[0] - camera.project(points)[0]).max() < SAME_PX
        assert (other.width, other.height) == (camera.width, camera.height)
    for table, keys in (("frames", ["frame"]), ("images", ["camera", "frame"])):
        first, second = (pd.read_parquet(results / f"index/{table}.parquet") for _, results in (imported, again))
        pd.testing.assert_frame_equal(first[keys], second[keys])
    frames = [pd.read_parquet(results / "index/frames.parquet") for _, results in (imported, again)]
    pd.testing.assert_frame_equal(*frames)
    arrays = [read_arrays(results / "tracking/0000.safetensors") for _, results in (imported, again)]
    np.testing.assert_array_equal(arrays[0]["frames"], arrays[1]["frames"])
    np.testing.assert_allclose(arrays[0]["vertices"], arrays[1]["vertices"], atol=SAME_M)


def test_lights_and_patterns_of_goliath_come_back(imported, again):
    places = [pd.read_parquet(results / "calibration/lights.parquet") for _, results in (imported, again)]
    np.testing.assert_allclose(places[0][["x", "y", "z"]], places[1][["x", "y", "z"]], atol=1e-12)
    lit = [
        pd.read_parquet(results / "index/patterns.parquet").sort_values(["frame", "light"], ignore_index=True)
        for _, results in (imported, again)
    ]
    pd.testing.assert_frame_equal(lit[0][["frame", "light"]], lit[1][["frame", "light"]])
    np.testing.assert_allclose(lit[0].intensity_r, lit[1].intensity_r, atol=DURATION_STEP)


def test_images_and_masks_of_goliath_come_back(imported, again):
    second = pd.read_parquet(again[1] / "index/images.parquet").set_index(["camera", "frame"])
    for row in some_images(imported):
        linear, subject = recorded(imported, row)
        other = second.loc[(row.camera, row.frame)]
        found, masked = recorded(again, other.rename(None).to_frame().T.assign(camera=row.camera).iloc[0])
        assert (np.abs(found - linear) / WHITE_BALANCE).max() < LOSSY_COUNTS / 255
        assert (subject is None) == (masked is None)
        if subject is not None:
            np.testing.assert_array_equal(masked, subject)


def test_goliath_layout_is_as_the_sets_loader_reads_it(imported, exported):
    """Its own steps: transposed K and T, half a pixel, world-from-head, labels twice as large."""
    root = exported["goliath"] / "someone--Head"
    vertices = read_arrays(imported[1] / "tracking/0000.safetensors")["vertices"][3]
    entry = json.loads((root / "camera_calibration.json").read_text())["KRT"][0]
    K, Rt = np.array(entry["K"]).T, np.array(entry["T"]).T[:3, :4]
    with zipfile.ZipFile(root / "head_pose/head_pose.zip") as archive:
        pose = np.array([line.split(" ") for line in archive.read("000003.txt").decode().splitlines()], np.float64)
    with zipfile.ZipFile(root / "kinematic_tracking/registration_vertices.zip") as archive:
        content = archive.read("registration_vertices/000003.ply")
    in_head = np.frombuffer(content.split(b"end_header\n", 1)[1], "<f4").reshape(-1, 3)
    world = in_head @ pose[:, :3].T + pose[:, 3]
    np.testing.assert_allclose(world / 1000, vertices, atol=SAME_M)
    seen = world @ Rt[:, :3].T + Rt[:, 3]
    pixels = (seen[:, :2] / seen[:, 2:]) @ K[:2, :2].T / 2 + (K[:2, 2] + 0.5) / 2 - 0.5
    with zipfile.ZipFile(root / f"segmentation_parts/cam{entry['cameraId']}.zip") as archive:
        content = np.frombuffer(archive.read(f"cam{entry['cameraId']}/000003.png"), np.uint8)
    labels = cv2.imdecode(content, cv2.IMREAD_UNCHANGED).repeat(2, 0).repeat(2, 1)
    at = np.round(pixels).astype(int)
    assert (labels[at[:, 1], at[:, 0]] == 2).mean() > 0.9, "only vertices on the outline may fall beside it"


def test_some_frames_and_brighter(imported, tmp_path):
    run(**inputs(imported), layout="nerfstudio", out=tmp_path, settings=ExportCapture(frames=2, exposure=2.0))
    content = json.loads((tmp_path / "transforms.json").read_text())
    assert len({frame["file_path"].split("/")[2] for frame in content["frames"]}) == 2
    row = next(some_images(imported))
    stored = cv2.imread(str(tmp_path / "images" / f"{row.camera}/{row.frame:06d}.png"))[..., ::-1]
    assert np.abs(stored / 255 - srgb(2 * recorded(imported, row)[0])).max() < HALF_COUNT


def refusal(imported, tmp_path, layout, **changes):
    with pytest.raises(InputError) as caught:
        run(**inputs(imported) | changes, layout=layout, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()
    return str(caught.value)


def changed_cameras(imported, tmp_path, change):
    cameras = read_cameras(imported[1] / "calibration/cameras.json")
    change(cameras)
    write_cameras(tmp_path / "cameras.json", cameras)
    return {"cameras": tmp_path / "cameras.json"}


def fisheye(cameras):
    name = sorted(cameras)[1]
    cameras[name] = replace(cameras[name], lens=FISHEYE, dist=np.zeros(4))


def test_layouts_that_cannot_hold_a_lens_refuse_it(imported, tmp_path):
    given = changed_cameras(imported, tmp_path, fisheye)
    message = refusal(imported, tmp_path, "nerfstudio", **given)
    assert "expected one model of lens for all cameras, found OPENCV of 400001, OPENCV_FISHEYE of" in message
    assert "expected a perspective lens, found fisheye" in refusal(imported, tmp_path, "goliath", **given)
    run(**inputs(imported) | given, layout="colmap", out=tmp_path / "colmap")
    models = {camera.model_name for camera in pycolmap.Reconstruction(tmp_path / "colmap/sparse/0").cameras.values()}
    assert models == {"OPENCV_FISHEYE", "OPENCV"} or models == {"OPENCV_FISHEYE", "FULL_OPENCV"}


def test_a_camera_without_calibration_is_named(imported, tmp_path):
    given = changed_cameras(imported, tmp_path, lambda cameras: cameras.pop("400017"))
    assert "expected all cameras of the images, found none of 400017" in refusal(imported, tmp_path, "colmap", **given)


def test_images_of_another_size_are_named(imported, tmp_path):
    def double(cameras):
        cameras["400017"] = replace(cameras["400017"], width=2 * cameras["400017"].width)

    given = changed_cameras(imported, tmp_path, double)
    assert "expected 96 x 72 pixels, found 48 x 72" in refusal(imported, tmp_path, "colmap", **given)


def test_goliath_needs_lights_patterns_and_tracking(imported, tmp_path):
    assert "expected all three for the layout goliath" in refusal(imported, tmp_path, "goliath", lights=None)
    assert "expected all three for the layout goliath" in refusal(imported, tmp_path, "goliath", tracking=())


def copied_index(imported, tmp_path, **facts):
    shutil.copytree(imported[1] / "index", tmp_path / "index")
    content = json.loads((tmp_path / "index/capture.json").read_text()) | facts
    write_json(tmp_path / "index/capture.json", content)
    return tmp_path / "index"


def test_bodies_have_no_goliath_layout(imported, tmp_path):
    index = copied_index(imported, tmp_path, kind="body")
    assert "expected a capture of kind head, found body" in refusal(imported, tmp_path, "goliath", index=index)


def test_lights_that_change_colour_have_no_goliath_layout(imported, tmp_path):
    patterns = pd.read_parquet(imported[1] / "index/patterns.parquet")
    patterns.loc[patterns.light == "L003", "intensity_b"] *= 0.5
    patterns.to_parquet(tmp_path / "patterns.parquet")
    message = refusal(imported, tmp_path, "goliath", patterns=tmp_path / "patterns.parquet")
    assert "expected lights of one intensity in all channels, found others of L003" in message


def test_lights_without_a_place_are_named(imported, tmp_path):
    lights = pd.read_parquet(imported[1] / "calibration/lights.parquet")
    lights[lights.light != "L005"].to_parquet(tmp_path / "lights.parquet")
    message = refusal(imported, tmp_path, "goliath", lights=tmp_path / "lights.parquet")
    assert "expected the place of every light, found none of L005" in message


def test_what_goliath_layout_cannot_say_is_in_the_log(imported, tmp_path, caplog):
    index = copied_index(imported, tmp_path, fps=24.0)
    images = pd.read_parquet(index / "images.parquet")
    images.assign(test_camera=images.camera == "400017").to_parquet(index / "images.parquet")
    run(**inputs(imported) | {"index": index}, layout="goliath", out=tmp_path / "out")
    assert "other readers will take 10, not 24" in caplog.text
    assert "the layout names no test cameras: other readers will take 401645, not 400017" in caplog.text


def test_what_goliath_layout_has_no_place_for_comes_back_from_a_file_beside_it(imported, tmp_path):
    index = copied_index(imported, tmp_path, fps=24.0)
    images = pd.read_parquet(index / "images.parquet")
    images.assign(test_camera=images.camera == "400017").to_parquet(index / "images.parquet")
    given = inputs(imported) | {"index": index}
    for name in ("lights", "patterns"):
        table = pd.read_parquet(given[name])
        given[name] = tmp_path / f"{name}.parquet"
        # Names whose order is another one than that of the lights' numbers.
        table.assign(light="lamp " + table.light.str[::-1]).to_parquet(given[name])
    run(**given, layout="goliath", out=tmp_path / "out")
    root = tmp_path / "out/someone--Head"
    import_capture.run(dataset="goliath", source=root, subject="again", out=tmp_path / "again")
    described = yaml.safe_load((tmp_path / "again/capture.yaml").read_text())
    assert described["fps"] == 24 and described["splits"]["test_cameras"] == ["400017"]
    lights = pd.read_csv(tmp_path / "again/lights.csv").set_index("light")
    known = pd.read_parquet(given["lights"]).set_index("light")
    np.testing.assert_allclose(lights[["x", "y", "z"]], known.loc[lights.index, ["x", "y", "z"]], atol=1e-12)
    lit = pd.read_csv(tmp_path / "again/patterns.csv").set_index(["frame", "light"]).intensity.sort_index()
    true = pd.read_parquet(given["patterns"]).set_index(["frame", "light"]).intensity_r.sort_index()
    assert lit.index.tolist() == true[true.index.get_level_values(0).isin(described_frames(tmp_path))].index.tolist()
    np.testing.assert_allclose(lit, true.loc[lit.index], atol=DURATION_STEP)
    (root / "lightstage.json").write_text('{"fps": 24, "test_cameras": [], "lights": ["one"]}')
    with pytest.raises(InputError, match="16 names of lights and a positive fps, found 1 and 24; delete it"):
        import_capture.run(dataset="goliath", source=root, subject="again", out=tmp_path / "again")


def described_frames(folder):
    return pd.read_csv(folder / "again/frames.csv").frame.tolist()


def test_frames_without_meshes_are_named(imported, tmp_path):
    for name in ("0000.safetensors", "0000.parquet"):
        shutil.copy(imported[1] / f"tracking/{name}", tmp_path / name)
    table = pd.read_parquet(tmp_path / "0000.parquet").assign(status="between")
    table.to_parquet(tmp_path / "0000.parquet")
    message = refusal(imported, tmp_path, "goliath", tracking=(tmp_path / "0000.safetensors",))
    assert "--tracking: expected meshes of frames 0, 1, 2, 3, 4 ... (11 in all), found none" in message


def test_what_is_not_this_stages_is_not_replaced(imported, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/notes.txt").write_text("keep")
    with pytest.raises(InputError, match="export_capture"):
        run(**inputs(imported), layout="colmap", out=tmp_path / "mine")
    assert (tmp_path / "mine/notes.txt").read_text() == "keep"
