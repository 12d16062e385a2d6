"""Mean textures of a matte ball that Mitsuba photographed, against its colour times the light that falls on it."""

from __future__ import annotations

import logging
import shutil

import cv2
import numpy as np
import pandas as pd
import pytest
import trimesh
from safetensors.numpy import load_file
from scipy.spatial.transform import Rotation

from benchmarks.effect_scenes import SCENES, make_scene
from benchmarks.effect_shapes import BALL_RADIUS_M
from pipeline.base.errors import InputError
from pipeline.base.exr import write_exr
from pipeline.base.files import read_json, write_json
from pipeline.capture.head_data import read_textures
from pipeline.capture.images import read_image
from pipeline.figures.atlas_sheet import BORDER_PX, CAPTION_PX
from pipeline.geometry.cameras import read_cameras, write_cameras
from pipeline.geometry.texels import read_atlas
from pipeline.stages.bake_textures import run
from pipeline.synthesis.appearance import mottle

pytest.importorskip("mitsuba")

CHANGES = {
    "cameras": 6, "test_cameras": 1, "frames": 5, "frames_b": 1, "test_frames": 1, "width": 56, "height": 56, "spp": 64,
    "lights": 5, "partial_lights_min": 1, "partial_lights_max": 2, "light_distance_m": 1.5,
    "total_intensity": 6.0 * 1.5**2,
}  # fmt: skip
FULLY_LIT = [0, 3]
"""Frame 4 is of another segment."""

NOISE = 0.05
"""Standard deviation of a texel, relative to what it should show: 64 paths to one of five lights, of which half shine
on it, leave 13 % in a pixel, and about three cameras' pixels and their neighbours are averaged."""

HALF = 2.0**-10
"""Of numbers up to 1, twice the rounding of float16."""


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ball")
    files = make_scene(folder, "diffuse", 32, **CHANGES)
    write_json(folder / "effects.json", {"color_correction": {"on": False}})
    return folder, files | {"effects": folder / "effects.json"}


@pytest.fixture
def own_ball(ball, tmp_path):
    """A copy to change."""
    folder = tmp_path / "ball"
    shutil.copytree(ball[0], folder)
    return folder, {name: folder / path.relative_to(ball[0]) for name, path in ball[1].items()}


def unwrapped(ball, out):
    names = ("capture", "index", "atlas", "tracking", "cameras", "color", "effects", "frames")
    run(**{name: ball[1][name] for name in names}, out=out / "0000")
    return read_textures(out / "0000.safetensors")


def edit_table(path, change):
    change(pd.read_parquet(path)).to_parquet(path)


def falling_light(ball, frame):
    """Albedo x irradiance / pi of a matte ball at the texels, in closed form, and their normals."""
    atlas, shape = read_atlas(ball[1]["atlas"]), SCENES["diffuse"].shape()
    corners = np.asarray(trimesh.creation.icosphere(3, BALL_RADIUS_M).vertices)[shape.unwrapped.source]
    normals = np.einsum("tc,tcd->td", atlas.barycentric, corners[atlas.corners])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    albedo = np.array([0.55, 0.4, 0.3]) * mottle(BALL_RADIUS_M * normals, "ball", 0.06, 0.16)[:, None]
    vertices = load_file(ball[1]["tracking"])["vertices"][frame].astype(np.float64)
    middle = vertices.mean(0)
    turn, _ = Rotation.align_vectors(vertices - middle, corners)
    normals = turn.apply(normals)
    patterns = pd.read_parquet(ball[1]["patterns"]).merge(pd.read_parquet(ball[1]["lights"]), on="light")
    lit = patterns[patterns.frame == frame]
    to_light = lit[["x", "y", "z"]].to_numpy() - (BALL_RADIUS_M * normals + middle)[:, None]
    distance = np.linalg.norm(to_light, axis=-1)
    cosine = np.maximum((to_light * normals[:, None]).sum(-1) / distance, 0)
    return albedo / np.pi * (cosine / distance**2 @ lit.intensity_g.to_numpy())[:, None], normals


def test_fully_lit_texels_show_albedo_times_falling_light(ball, tmp_path):
    textures = unwrapped(ball, tmp_path)
    assert sorted(textures) == list(range(5))
    for frame in FULLY_LIT:
        expected, normals = falling_light(ball, frame)
        seen = np.abs(normals[:, 1]) < 0.7  # the cameras stand around it; its poles are filled in
        ratio = textures[frame][seen] / expected[seen]
        assert seen.sum() > 200
        assert abs(np.median(ratio) - 1) < 0.01
        assert np.sqrt(np.mean((ratio - 1) ** 2)) < 2 * NOISE
        assert np.corrcoef(textures[frame][seen].ravel(), expected[seen].ravel())[0, 1] > 0.98
    linear = textures[0].astype(np.float64).clip(0, 1)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    row, column = read_atlas(ball[1]["atlas"]).texel.T
    shown = cv2.imread(str(tmp_path / "0000.png"))[CAPTION_PX + row, BORDER_PX + column, ::-1]
    assert np.abs(shown - 255 * encoded).max() <= 1 + 255 * HALF


def test_other_frames_lie_between_fully_lit_ones(ball, tmp_path):
    textures = unwrapped(ball, tmp_path)
    np.testing.assert_allclose(textures[1], (2 * textures[0] + textures[3]) / 3, atol=HALF)
    np.testing.assert_array_equal(textures[4], textures[3])


def test_a_segment_takes_nothing_from_another_that_has_lit_frames_too(own_ball, tmp_path):
    edit_table(own_ball[1]["frames"], lambda t: t.assign(segment=["a", "a", "b", "b", "b"]))
    textures = unwrapped(own_ball, tmp_path)
    for frame, same in ((1, 0), (2, 3), (4, 3)):
        np.testing.assert_array_equal(textures[frame], textures[same])


def test_cameras_held_out_play_no_part(ball, own_ball, tmp_path):
    images = pd.read_parquet(own_ball[1]["index"] / "images.parquet")
    for path in images.path[images.test_camera]:
        (own_ball[0] / path).unlink()
    for name, texture in unwrapped(own_ball, tmp_path / "without").items():
        np.testing.assert_array_equal(texture, unwrapped(ball, tmp_path / "with")[name])


def test_an_image_that_is_all_black_is_left_out(ball, own_ball, tmp_path, caplog):
    images = pd.read_parquet(own_ball[1]["index"] / "images.parquet")
    path = images.path[(images.frame == 3) & ~images.test_camera].iloc[0]
    write_exr(own_ball[0] / path, np.zeros_like(read_image(own_ball[0] / path, "linear", 0.0)))
    with caplog.at_level(logging.WARNING):
        found = unwrapped(own_ball, tmp_path / "dark")[3]
    assert f"{path}: all that is seen of the subject is black; left out" in caplog.text
    # Others see most of what it saw.
    change = np.abs(found / np.maximum(unwrapped(ball, tmp_path / "light")[3], 1e-3) - 1)
    assert np.mean(change < 4 * NOISE) > 0.9
    assert found.min() > 0


def test_what_one_camera_does_not_see_gets_its_neighbours_colour(own_ball, tmp_path, caplog):
    only = pd.read_parquet(own_ball[1]["index"] / "images.parquet").query("~test_camera").camera.iloc[0]
    edit_table(own_ball[1]["index"] / "images.parquet", lambda t: t[t.camera == only])
    with caplog.at_level(logging.INFO):
        textures = unwrapped(own_ball, tmp_path)
    assert "texels are seen in no frame and get the colour of their neighbours" in caplog.text
    expected, normals = falling_light(own_ball, 0)
    camera = read_cameras(own_ball[1]["cameras"])[only].center
    facing = normals @ camera / np.linalg.norm(camera)
    near = facing > 0.5
    assert np.sqrt(np.mean((textures[0][near] / expected[near] - 1) ** 2)) < 4 * NOISE
    assert textures[0][facing < 0].min() > 0.5 * expected[near].min()


def test_without_a_fully_lit_frame_all_share_one_texture(own_ball, tmp_path, caplog):
    edit_table(own_ball[1]["frames"], lambda t: t.assign(fully_lit=False))
    textures = unwrapped(own_ball, tmp_path)
    assert "no fully lit frame: all 5 frames share one mean texture" in caplog.text
    assert textures[0].max() > 0.1
    for texture in textures.values():
        np.testing.assert_array_equal(texture, textures[0])


def test_colors_are_corrected_if_that_is_planned(ball, own_ball, tmp_path):
    tint = np.array([[0.5, 0.1, 0.0], [0.0, 1.2, 0.0], [0.1, 0.0, 2.0]])
    cameras = read_json(own_ball[1]["color"])["cameras"]
    write_json(own_ball[1]["color"], {"cameras": dict.fromkeys(cameras, tint.tolist())})
    plain = unwrapped(ball, tmp_path / "plain")[0]
    np.testing.assert_array_equal(unwrapped(own_ball, tmp_path / "off")[0], plain)
    write_json(own_ball[1]["effects"], {"color_correction": {"on": True}})
    np.testing.assert_allclose(unwrapped(own_ball, tmp_path / "on")[0], plain @ tint.T, atol=4 * HALF)


def test_frames_that_were_not_booked_get_none_and_none_booked_is_an_error(own_ball, tmp_path):
    edit_table(own_ball[1]["frames"], lambda t: t[t.frame < 3])
    assert sorted(unwrapped(own_ball, tmp_path)) == [0, 1, 2]
    edit_table(own_ball[1]["frames"], lambda t: t.assign(frame=t.frame + 100))
    with pytest.raises(InputError, match="expected at least one frame that"):
        unwrapped(own_ball, tmp_path)


def test_what_is_missing_is_named(own_ball, tmp_path):
    cameras = read_cameras(own_ball[1]["cameras"])
    write_cameras(own_ball[1]["cameras"], {name: cameras[name] for name in list(cameras)[1:]})
    with pytest.raises(InputError, match=f"{next(iter(cameras))}: expected a calibrated camera"):
        unwrapped(own_ball, tmp_path)
    edit_table(own_ball[1]["index"] / "images.parquet", lambda t: t.assign(test_camera=True))
    with pytest.raises(InputError, match="expected images of fully lit frames by training cameras, found none"):
        unwrapped(own_ball, tmp_path)
