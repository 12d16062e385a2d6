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
from pipeline.avatar.training.checkpoint import save_avatar
from pipeline.base.color import srgb_from_linear
from pipeline.base.errors import InputError
from pipeline.base.files import write_arrays
from pipeline.capture.images import read_exr_channel, read_stored, write_exr
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
