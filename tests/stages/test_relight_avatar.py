"""The stage from an avatar and a light to pictures, without Snakemake: what is in each file, what is refused."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pandas as pd
import pytest
import torch

from pipeline.avatar.model import Avatar
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.spec.planned import resolve_spec
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.avatar.training.checkpoint import load_avatar, save_avatar
from pipeline.base.color import srgb_from_linear
from pipeline.base.errors import InputError
from pipeline.base.exr import write_exr
from pipeline.base.files import write_arrays
from pipeline.capture.images import read_exr_channel, read_stored
from pipeline.capture.records import ImageRecord
from pipeline.capture.shards import write_image_shard
from pipeline.config.relight_avatar import RelightAvatar
from pipeline.config.train_avatar import TrainAvatar
from pipeline.geometry.camera_paths import orbit
from pipeline.geometry.cameras import write_cameras
from pipeline.geometry.texels import write_atlas
from pipeline.rendering.splat_ply import read_splats
from pipeline.stages import relight_avatar as stage
from tests.support.avatars.sheet import make_sheet

SMALL = {"height": 32, "width": 24, "orbit_radius": 1.2, "orbit_rise": 0.0, "orbit_turns": 0.0}
LIGHT = "light,x,y,z,r,g,b\nkey,0.1,0.2,1.5,2,1.5,1\n"


@pytest.fixture
def inputs(tmp_path):
    """A sheet that moves 1 cm to the right in each of three frames."""
    atlas = make_sheet(10)
    write_atlas(tmp_path / "atlas.safetensors", atlas)
    spec = AvatarSpec(specular=True, shadow=True, shadow_width=4, supersample=1, dilation_px2=0.1)
    save_avatar(tmp_path / "avatar", Avatar(atlas, texel_spacing(atlas), spec), {})
    moved = atlas.rest_vertices + np.array([0, 0.01, 0.02], np.float32)[:, None, None] * np.float32([1, 0, 0])
    write_arrays(tmp_path / "0000.safetensors", {"frames": np.arange(5, 8), "vertices": moved.astype(np.float32)})
    (tmp_path / "lights.csv").write_text(LIGHT)
    (tmp_path / "brighter.csv").write_text(LIGHT.replace("2,1.5,1", "4,3,2"))
    radiance = np.random.default_rng(0).random((16, 32, 3))
    write_exr(tmp_path / "sky.exr", radiance, half=False)
    return {
        "atlas": tmp_path / "atlas.safetensors", "avatar": tmp_path / "avatar",
        "tracking": (tmp_path / "0000.safetensors",),
    }  # fmt: skip


def film_length(path) -> int:
    film, count = cv2.VideoCapture(str(path)), 0
    while film.read()[0]:
        count += 1
    return count


def linear(folder, picture: int) -> np.ndarray:
    path = folder / f"stills/{picture:06d}.exr"
    return np.stack([read_exr_channel(path, name) for name in "RGBA"], -1)


def test_pictures_under_a_point_light(inputs, tmp_path):
    settings = RelightAvatar(**SMALL, stills="both", splats="all", exposure=1.5)
    stage.run(**inputs, lights=tmp_path / "lights.csv", out=tmp_path / "out", settings=settings)
    table = pd.read_parquet(tmp_path / "out/pictures.parquet")
    assert table.frame.tolist() == [5, 6, 7]
    assert film_length(tmp_path / "out/film.mp4") == 3
    for picture in range(3):
        rgba, png = linear(tmp_path / "out", picture), read_stored(tmp_path / f"out/stills/{picture:06d}.png")
        assert rgba[16, 12, 3] > 0.9
        assert rgba[0, 0].max() == 0
        shown = srgb_from_linear(1.5 * rgba[..., :3]).clip(0, 1) * 255
        np.testing.assert_allclose(png, shown, atol=0.8)  # rounding, and half floats
    # The camera stands still in front of the middle frame, and the sheet moves to the right.
    centers = [(np.arange(24) * linear(tmp_path / "out", p)[..., 3].sum(0)).sum() for p in range(3)]
    assert centers[0] < centers[1] < centers[2]
    np.testing.assert_allclose(read_splats(tmp_path / "out/splats/000002.ply").means[:, 0].mean(), 0.02, atol=1e-4)


def test_twice_the_light_is_twice_the_radiance(inputs, tmp_path):
    settings = RelightAvatar(**SMALL, stills="exr", splats="none", last_frame=5)
    for name in ("lights", "brighter"):
        stage.run(**inputs, lights=tmp_path / f"{name}.csv", out=tmp_path / name, settings=settings)
    one, two = (linear(tmp_path / name, 0) for name in ("lights", "brighter"))
    assert one[..., :3].max() > 0.05
    np.testing.assert_array_equal(two[..., :3], 2 * one[..., :3])
    assert not (tmp_path / "lights/splats").exists()


def test_environment_by_lobes_and_by_pixels_before_itself(inputs, tmp_path):
    """Both ways agree where the avatar is, and the map shows around it."""
    for light in ("lobes", "pixels"):
        settings = RelightAvatar(
            **SMALL,
            stills="both",
            environment_light=light,
            environment_turns=1,
            pictures=4,
            first_frame=6,
            last_frame=6,
        )
        stage.run(**inputs, environment=tmp_path / "sky.exr", out=tmp_path / light, settings=settings)
    assert pd.read_parquet(tmp_path / "lobes/pictures.parquet").frame.tolist() == [6] * 4
    lobes, pixels = (np.stack([linear(tmp_path / light, p) for p in range(4)]) for light in ("lobes", "pixels"))
    assert lobes[..., :3].max() > 0.05
    assert np.abs(lobes - pixels).max() < 0.02 * pixels[..., :3].max()
    assert np.abs(lobes[0] - lobes[2]).max() > 0.01  # the map has turned
    png = read_stored(tmp_path / "lobes/stills/000000.png")
    assert png[0, 0].min() > 0


@pytest.mark.parametrize("names", [("a",), ("a", "b")])
def test_calibrated_cameras(inputs, tmp_path, names):
    known = dict(zip("ab", orbit(np.zeros(3), 0.8, 0.0, 0.25, 40.0, 40, 60, 2), strict=True))
    write_cameras(tmp_path / "cameras.json", known)
    settings = RelightAvatar(camera_names=names, height=30, stills="png", splats="none")
    stage.run(
        **inputs, lights=tmp_path / "lights.csv", cameras=tmp_path / "cameras.json", out=tmp_path / "out",
        settings=settings,
    )  # fmt: skip
    table = pd.read_parquet(tmp_path / "out/pictures.parquet")
    np.testing.assert_allclose(table[["x", "y", "z"]].iloc[0], known["a"].center, atol=1e-9)
    np.testing.assert_allclose(table[["x", "y", "z"]].iloc[2], known[names[-1]].center, atol=1e-9)
    assert read_stored(tmp_path / "out/stills/000000.png").shape == (30, 20, 3)


def test_keyframes_lead_the_camera(inputs, tmp_path):
    keys = [{"picture": p, "eye": [0, 0, z], "target": [0, 0, 0]} for p, z in ((0, 1.0), (2, 0.5))]
    (tmp_path / "keys.json").write_text(json.dumps({"keyframes": keys}))
    settings = RelightAvatar(height=30, width=20, stills="none", splats="none")
    stage.run(
        **inputs, lights=tmp_path / "lights.csv", keyframes=tmp_path / "keys.json", out=tmp_path / "out",
        settings=settings,
    )  # fmt: skip
    assert pd.read_parquet(tmp_path / "out/pictures.parquet").z.tolist() == pytest.approx([1, 0.75, 0.5])
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [".written_by", "film.mp4", "pictures.parquet"]


@pytest.mark.parametrize(
    ("light", "settings", "said"),
    [
        ({}, {}, "name one light"),
        ({"lights": "lights.csv", "environment": "sky.exr"}, {}, "name one light"),
        ({"lights": "lights.csv"}, {"first_frame": 9}, "first-frame"),
        ({"lights": "lights.csv"}, {"camera_names": ("z",)}, "camera-names"),
        ({"lights": "lights.csv"}, {"orbit_center": (1.0,)}, "three numbers"),
    ],
)
def test_what_is_wrong_is_said_before_anything_is_written(inputs, tmp_path, light, settings, said):
    files = {name: tmp_path / file for name, file in light.items()}
    with pytest.raises(InputError, match=said):
        stage.run(**inputs, **files, out=tmp_path / "out", settings=RelightAvatar(**settings))
    assert not (tmp_path / "out").exists()


def test_map_is_prefiltered_at_the_height_that_is_asked_for(inputs, tmp_path):
    """A map of its own height is the map; the more it is reduced, the further the lobes are off."""
    shown = {}
    for height in (None, 4096, 8, 2):
        settings = RelightAvatar(
            **SMALL, stills="exr", environment_light="lobes", pictures=1, prefiltered_height=height, background="black"
        )
        stage.run(**inputs, environment=tmp_path / "sky.exr", out=tmp_path / str(height), settings=settings)
        shown[height] = linear(tmp_path / str(height), 0)[..., :3]
    np.testing.assert_array_equal(shown[None], shown[4096])
    errors = [np.abs(shown[height] - shown[None]).mean() for height in (8, 2)]
    assert 0 < errors[0] < errors[1]


def test_lamps_turn_about_the_middle_of_what_is_shown(inputs, tmp_path):
    """In the third of four pictures of a round the lamp is behind the sheet; in the second and fourth, beside it."""
    settings = RelightAvatar(**SMALL, stills="exr", splats="none", light_turns=1, pictures=4, last_frame=5)
    stage.run(**inputs, lights=tmp_path / "lights.csv", out=tmp_path / "out", settings=settings)
    front, right, behind, left = (linear(tmp_path / "out", picture)[16, 12, :3] for picture in range(4))
    assert front.min() > 0.02
    assert max(right.max(), left.max()) < 0.3 * front.max()
    assert behind.max() < 1e-3 * front.max()


def test_layers_of_a_still_add_up_to_it(inputs, tmp_path):
    settings = RelightAvatar(**SMALL, stills="exr", exr_layers=True, splats="none", last_frame=5)
    stage.run(**inputs, lights=tmp_path / "lights.csv", out=tmp_path / "out", settings=settings)
    still = tmp_path / "out/stills/000000.exr"
    layer = lambda name, channels="RGB": np.stack([read_exr_channel(still, f"{name}.{c}") for c in channels], -1)  # noqa: E731
    rgba = linear(tmp_path / "out", 0)
    total = layer("diffuse") + layer("indirect") + layer("specular")
    np.testing.assert_allclose(total, rgba[..., :3], atol=2e-3)  # half floats
    assert layer("specular")[16, 12].min() > 0 and layer("indirect").max() == 0
    albedo = load_avatar(inputs["avatar"], inputs["atlas"]).avatar.albedo.detach()[0]
    np.testing.assert_allclose(layer("albedo")[16, 12] / rgba[16, 12, 3], albedo, rtol=2e-3)
    np.testing.assert_allclose(layer("normal", "XYZ")[16, 12] / rgba[16, 12, 3], [0, 0, 1], atol=2e-3)
    np.testing.assert_allclose(read_exr_channel(still, "Z")[16, 12], 1.2, rtol=2e-3)
    with pytest.raises(InputError, match="--exr-layers: expected --stills exr or both, found png"):
        settings = RelightAvatar(exr_layers=True)
        stage.run(**inputs, lights=tmp_path / "lights.csv", out=tmp_path / "no", settings=settings)


def test_captured_pictures_stand_beside(inputs, tmp_path):
    """Each frame's own, where the camera saw it: a crop of a picture half as large; black where there is none."""
    (camera,) = orbit(np.zeros(3), 0.8, 0.0, 0.0, 40.0, 40, 60, 1)
    write_cameras(tmp_path / "cameras.json", {"a": camera})
    crop = camera.K / np.array([[2.0], [2], [1]]) - np.array([[0, 0, 4.0], [0, 0, 6], [0, 0, 0]])
    colors = np.zeros((12, 10, 3), np.float32) + np.float32([0.8, 0.4, 0.1])
    seen = ImageRecord("a", 6, False, False, False, False, True, 4, 6, 10, 12, colors, colors[..., 0], crop,
                       camera.R, camera.t)  # fmt: skip
    for split in ("train", "validation", "test"):
        write_image_shard(tmp_path / f"shards/{split}/0000.arrow", [seen] if split == "train" else [])
    settings = RelightAvatar(camera_names=("a",), height=60, splats="none", beside_captured=True)
    files = {"lights": tmp_path / "lights.csv", "cameras": tmp_path / "cameras.json"}
    stage.run(**inputs, **files, shards=tmp_path / "shards", out=tmp_path / "out", settings=settings)
    pictures = [read_stored(tmp_path / f"out/stills/{picture:06d}.png") for picture in range(3)]
    assert pictures[0].shape == (60, 80, 3) and film_length(tmp_path / "out/film.mp4") == 3
    assert [picture[:, :40].any() for picture in pictures] == [False, True, False]
    captured = pictures[1][:, :40]
    inside = np.zeros((60, 40), bool)
    inside[13:35, 9:27] = True  # pixels 8 to 27 and 12 to 35, without the rim
    expected = np.round(srgb_from_linear(colors[0, 0]) * 255)
    np.testing.assert_array_equal(captured[inside], np.broadcast_to(expected, (inside.sum(), 3)))
    assert not captured[:11].any() and not captured[:, 29:].any()
    for said, chosen, given in (
        ("expected one of --camera-names", {}, files | {"shards": tmp_path / "shards"}),
        ("expected one of --camera-names", {"camera_names": ("a",)}, files),
        ("expected pictures of b", {"camera_names": ("b",)}, files | {"shards": tmp_path / "shards"}),
    ):
        write_cameras(tmp_path / "cameras.json", {"a": camera, "b": camera})
        with pytest.raises(InputError, match=said):
            stage.run(**inputs, **given, out=tmp_path / "no", settings=RelightAvatar(beside_captured=True, **chosen))


def test_a_head_is_driven_by_its_tracked_expressions(inputs, tmp_path):
    """Frames of a head carry its motion; without textures, its code is that of its vertices."""
    atlas = make_sheet(10)
    choices = TrainAvatar(avatar="head", deferred="off", code_size=4, decoder_channels=(8, 4), pose_points=4)
    avatar = Avatar(atlas, texel_spacing(atlas), resolve_spec(choices, {"near_field", "specular"}))
    rest = torch.as_tensor(atlas.rest_vertices)
    bent = rest + torch.tensor([0.0, 0.0, 0.1]) * (torch.arange(len(rest)) == 1)[:, None]
    avatar.networks.expression.learn_statistics([rest, bent], [])
    save_avatar(tmp_path / "avatar", avatar, {})
    still = {
        "root_rotation": np.tile(np.float32([1, 0, 0, 0]), (2, 1)),
        "root_translation": np.zeros((2, 3), np.float32),
    }
    tracked = np.stack([atlas.rest_vertices, bent.numpy()]).astype(np.float32)
    write_arrays(tmp_path / "0000.safetensors", {"frames": np.arange(2), "vertices": tracked, **still})
    settings = RelightAvatar(**SMALL, stills="exr", splats="all")
    stage.run(**inputs, lights=tmp_path / "lights.csv", out=tmp_path / "out", settings=settings)
    assert film_length(tmp_path / "out/film.mp4") == 2
    depths = [read_splats(tmp_path / f"out/splats/{picture:06d}.ply").means[:, 2].max() for picture in range(2)]
    assert abs(float(depths[0])) < 0.01 and 0.05 < float(depths[1]) < 0.15
    assert linear(tmp_path / "out", 0)[..., 3].max() > 0.9
