"""What drives the films of relight_avatar: frames of a segment, latent codes, gaze; and what is refused."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
import pandas as pd
import pytest
import torch
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from pipeline.avatar.eyes.eye_parts import eye_texels
from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.training.checkpoint import save_avatar
from pipeline.base.errors import InputError
from pipeline.base.exr import write_exr
from pipeline.base.files import write_arrays, write_table
from pipeline.capture.head_data import write_textures
from pipeline.capture.images import read_exr_channel
from pipeline.config.relight_avatar import RelightAvatar
from pipeline.geometry.texels import write_atlas
from pipeline.rendering.splat_ply import read_splats
from pipeline.stages import relight_avatar as stage
from tests.support.avatars import eyeballs
from tests.support.avatars.heads import folded, folds, make_head, trained
from tests.support.avatars.sheet import make_sheet

SMALL = {"height": 24, "width": 20, "orbit_radius": 1.2, "orbit_rise": 0.0, "orbit_turns": 0.0}
LIGHT = "light,x,y,z,r,g,b\nkey,0.1,0.2,1.5,2,1.5,1\n"
ATLAS = make_sheet(8)
FRAMES = [folded(ATLAS, fold, number) for number, fold in enumerate((0.0, 0.05, 0.1, 0.02, 0.08))]
"""The last two are of another segment, in which the head has turned."""

TURNS = Rotation.from_euler("xyz", [[0, 0, 0], [0, 0.1, 0], [0.1, 0, 0], [0, 0.4, 0.1], [0.2, -0.3, 0]])
SHIFTS = np.array([[0, 0, 0], [0.01, 0, 0], [0, 0.02, 0], [0.1, 0.05, -0.1], [-0.05, 0, 0.1]])
FLOAT32_M = 1e-6
"""Rounding of positions of up to a metre."""

HALF_FLOAT = 2e-3
"""Textures are stored in 11 bits: colours up to 0.3 are rounded by 7e-5, of their deviation of 0.04 that is 0.002."""

SAME = {"stills": "exr", "splats": "all", **SMALL}


@pytest.fixture
def files(tmp_path):
    """Five tracked frames of a sheet in two chunks, their textures, two segments, and a lamp."""
    write_atlas(tmp_path / "atlas.safetensors", ATLAS)
    local = np.stack([frame.vertices for frame in FRAMES])
    world = np.stack([turn.apply(v) + shift for turn, shift, v in zip(TURNS, SHIFTS, local, strict=True)])
    for chunk, own in (("0000", slice(0, 3)), ("0001", slice(3, 5))):
        arrays = {
            "frames": np.arange(5)[own], "vertices": world[own].astype(np.float32),
            "root_rotation": np.roll(TURNS.as_quat(), 1, 1)[own].astype(np.float32),
            "root_translation": SHIFTS[own].astype(np.float32),
        }  # fmt: skip
        write_arrays(tmp_path / f"{chunk}.safetensors", arrays)
        colors = np.stack([frame.texture for frame in FRAMES])[own]
        write_textures(tmp_path / f"textures_{chunk}.safetensors", np.arange(5)[own], colors)
    write_table(tmp_path / "index/frames.parquet", pd.DataFrame({"frame": range(5), "segment": list("aaabb")}))
    write_table(tmp_path / "index/gaze.parquet", pd.DataFrame({name: [] for name in ("frame", "eye", *"xyz")}))
    (tmp_path / "lights.csv").write_text(LIGHT)
    return tmp_path


def film(folder, avatar, name, **settings):
    """Run the stage on everything there is; the folder of its film."""
    chunks = [folder / f"{chunk}.safetensors" for chunk in ("0000", "0001")]
    save_avatar(folder / "avatar", avatar, {})
    stage.run(
        atlas=folder / "atlas.safetensors", avatar=folder / "avatar", tracking=tuple(chunks),
        textures=tuple(path.with_name(f"textures_{path.name}") for path in chunks), index=folder / "index",
        lights=folder / "lights.csv", out=folder / name, settings=RelightAvatar(**SAME | settings),
    )  # fmt: skip
    return folder / name


def stills(out):
    paths = sorted((out / "stills").glob("*.exr"))
    return np.stack([[read_exr_channel(path, channel) for channel in "RGBA"] for path in paths])


def means(out):
    return np.stack([read_splats(path).means for path in sorted((out / "splats").glob("*.ply"))])


def codes(out):
    return pd.read_csv(out / "codes.csv").filter(like="code_").to_numpy(np.float32)


def on_texels(vertices):
    """Points of the texels on a posed template."""
    return (np.asarray(vertices)[ATLAS.faces[ATLAS.face]] * ATLAS.barycentric[..., None]).sum(1)


def film_length(path):
    reader, count = cv2.VideoCapture(str(path)), 0
    while reader.read()[0]:
        count += 1
    return count


@pytest.mark.parametrize(
    ("row", "motion"),
    [({}, "rest"), ({}, "tracked"), ({"deferred": "on"}, "tracked"), ({"anchors": "rigid"}, "tracked")],
)
def test_codes_of_a_film_given_back_give_the_same_film(files, row, motion):
    avatar = trained(ATLAS, folds(ATLAS), steps=9, **row)
    first = film(files, avatar, "first", head_motion=motion)
    again = film(files, avatar, "again", head_motion=motion, codes=str(first / "codes.csv"))
    shown = stills(first)
    np.testing.assert_array_equal(stills(again), shown)
    np.testing.assert_array_equal(means(again), means(first))
    assert (again / "codes.csv").read_text() == (first / "codes.csv").read_text()
    assert film_length(again / "film.mp4") == len(shown) == 5
    assert shown[:, 3].max() > 0.9 and np.abs(shown[2] - shown[0]).max() > 0.01  # there is a change to keep


def test_a_frames_code_is_that_of_its_own_vertices_and_mean_texture(files):
    avatar = make_head(ATLAS, folds(ATLAS))
    with torch.no_grad():  # networks add nothing before they have learned
        avatar.networks.expression.mean.parametrizations.weight.original0.fill_(1.0)
    expected = [avatar.networks.encode(FrameInputs(ATLAS, frame)).mean.detach().numpy() for frame in FRAMES]
    found = codes(film(files, avatar, "film", splats="none"))
    np.testing.assert_allclose(found, expected, atol=HALF_FLOAT)
    gray = [avatar.networks.expression.encode(torch.as_tensor(frame.vertices)).mean for frame in FRAMES]
    assert np.abs(found - torch.stack(gray).detach().numpy()).max() > 0.02  # so the texture counts


def test_on_tracked_vertices_codes_drive_by_the_decoded_ones(files):
    """Training saw one corner rise; frame 4 raises another, which no code can say."""
    avatar = make_head(ATLAS, folds(ATLAS), anchors="tracked")
    odd = FRAMES[4].vertices.copy()
    odd[3, 2] += 0.06
    arrays = {
        "frames": np.array([4]), "vertices": odd[None], "root_rotation": np.float32([[1, 0, 0, 0]]),
        "root_translation": np.zeros((1, 3), np.float32),
    }  # fmt: skip
    write_arrays(files / "0001.safetensors", arrays)
    write_textures(files / "textures_0001.safetensors", np.array([4]), FRAMES[4].texture[None])
    first = film(files, avatar, "first", first_frame=4)
    again = film(files, avatar, "again", first_frame=4, codes=str(first / "codes.csv"))
    decoded = avatar.networks.expression.vertices(torch.as_tensor(codes(first)[0])).detach().numpy()
    np.testing.assert_allclose(means(first)[0], on_texels(odd), atol=FLOAT32_M)
    np.testing.assert_allclose(means(again)[0], on_texels(decoded), atol=FLOAT32_M)
    assert abs(decoded[3, 2]) < 0.01 < abs(decoded[1, 2])


def test_a_segment_is_chosen_by_name(files):
    avatar = make_head(ATLAS, folds(ATLAS))
    for settings, frames in (({"segment": "b"}, [3, 4]), ({"segment": "a", "first_frame": 1}, [1, 2]), ({}, range(5))):
        out = film(files, avatar, "film", stills="none", **settings)
        assert pd.read_parquet(out / "pictures.parquet").frame.tolist() == list(frames)


def test_expressions_of_a_segment_on_a_head_that_is_held_still(files):
    """Without networks that were trained, Gaussians lie on the decoded vertices, moved as the head is."""
    avatar = make_head(ATLAS, folds(ATLAS))
    shown = {m: film(files, avatar, m, segment="b", head_motion=m) for m in ("tracked", "first", "rest")}
    for picture, code in enumerate(codes(shown["rest"])):
        local = on_texels(avatar.networks.expression.vertices(torch.as_tensor(code)).detach().numpy())
        for name, moved in (("tracked", picture), ("first", 0)):
            there = TURNS[3 + moved].apply(local) + SHIFTS[3 + moved]
            np.testing.assert_allclose(means(shown[name])[picture], there, atol=FLOAT32_M, err_msg=name)
        np.testing.assert_allclose(means(shown["rest"])[picture], local, atol=FLOAT32_M)
    assert np.ptp(means(shown["rest"]), axis=0).max() > 0.03  # the expression goes on
    np.testing.assert_array_equal(codes(shown["tracked"]), codes(shown["rest"]))


@pytest.mark.parametrize("light", ["lights", "environment"])
def test_codes_alone_drive_a_head_at_rest_and_lie_between_their_rows(files, light):
    avatar = trained(ATLAS, folds(ATLAS), steps=9)
    low, high = codes(film(files, avatar, "film", stills="none", last_frame=2))[[0, 2]]
    rows = [
        dict(zip(["picture", *(f"code_{i}" for i in range(4))], row, strict=True)) for row in ([4, *high], [1, *low])
    ]
    write_table(files / "keys.csv", pd.DataFrame(rows))
    write_exr(files / "sky.exr", np.full((4, 8, 3), 0.4), half=False)
    lit = {"environment": files / "sky.exr"} if light == "environment" else {"lights": files / "lights.csv"}
    settings = RelightAvatar(**SAME, codes=str(files / "keys.csv"), head_motion="rest", background="black")
    atlas, out = files / "atlas.safetensors", files / "out"
    stage.run(atlas=atlas, avatar=files / "avatar", out=out, settings=settings, **lit)
    assert pd.read_parquet(out / "pictures.parquet").columns.tolist() == ["picture", *"xyz"]
    assert film_length(out / "film.mp4") == 5
    for picture, share in enumerate((0, 0, 1 / 3, 2 / 3, 1)):
        np.testing.assert_allclose(codes(out)[picture], (1 - share) * low + share * high, atol=1e-6)
    raised = means(out)[..., 2].max(1)
    assert raised[0] == raised[1] < raised[2] < raised[3] < raised[4]
    assert raised[4] - raised[0] > 0.05  # of the 0.1 m that was filmed
    assert stills(out)[:, 3].max() > 0.9 and (stills(out)[:, :3].max((1, 2, 3)) > 0.05).all()


EYES = eyeballs.make_eyes()
HEAD = {
    "avatar": "head", "shading": "harmonics", "normals": "viewed", "code_size": 4, "decoder_channels": (4,),
    "pose_points": 4,
}  # fmt: skip


@cache
def eyes_atlas():
    return eyeballs.make_atlas(48)


@pytest.fixture
def eyed(files):
    """A head of two eyes, turned and filmed once; and a film of it for settings."""
    avatar = eyeballs.make_avatar(eyes_atlas(), EYES, **HEAD)
    write_atlas(files / "atlas.safetensors", eyes_atlas())
    save_avatar(files / "avatar", avatar, {})
    arrays = {
        "frames": np.array([3]), "vertices": (TURNS[3].apply(eyes_atlas().rest_vertices) + SHIFTS[3])[None],
        "root_rotation": np.roll(TURNS[3].as_quat(), 1)[None], "root_translation": SHIFTS[3][None],
    }  # fmt: skip
    write_arrays(
        files / "0000.safetensors", {k: v if k == "frames" else v.astype(np.float32) for k, v in arrays.items()}
    )

    def show(index=True, **settings):
        stage.run(
            atlas=files / "atlas.safetensors", avatar=files / "avatar", tracking=(files / "0000.safetensors",),
            index=files / "index" if index else None, lights=files / "lights.csv", out=files / "out",
            settings=RelightAvatar(**SAME | {"stills": "none"} | settings),
        )  # fmt: skip
        return means(files / "out")

    return show


def turned(ahead, eye, direction):
    """Where an eye's Gaussians are that look along `direction` in the head's frame, if they looked ahead before."""
    center = list(eyeballs.CENTERS.values())[eye]
    angle, axis = np.arccos(direction[2]), np.cross(eyeballs.AHEAD, direction)
    turn = Rotation.from_rotvec(angle * axis / max(np.linalg.norm(axis), 1e-12))
    local = TURNS[3].inv().apply(ahead - SHIFTS[3]) - center
    return TURNS[3].apply(turn.apply(local) + center) + SHIFTS[3]


def of_eye(eye):
    chosen, owner = eye_texels(eyes_atlas(), {name: one.vertices for name, one in sorted(EYES.items())})
    return chosen[owner == eye]


def yaw(degrees):
    return np.array([np.sin(np.radians(degrees)), 0.0, np.cos(np.radians(degrees))])


def test_eyes_follow_a_table_of_gaze_along_great_circles(eyed, files):
    rows = [(4, "eye_l", *yaw(40)), (0, "eye_l", *yaw(0)), (2, "eye_r", *yaw(-30))]
    write_table(files / "gaze.csv", pd.DataFrame(rows, columns=["picture", "eye", *"xyz"]))
    found = eyed(gaze=str(files / "gaze.csv"), pictures=6)
    ahead = eyed(gaze_direction=(0.0, 0.0, 1.0))[0]
    for picture, degrees in enumerate((0, 10, 20, 30, 40, 40)):
        for eye, looks in enumerate((yaw(degrees), yaw(-30))):
            own = of_eye(eye)
            expected = turned(ahead[own], eye, looks)
            np.testing.assert_allclose(found[picture][own], expected, atol=FLOAT32_M, err_msg=f"{picture} {eye}")
    assert np.abs(found[4] - found[0]).max() > 0.005


def test_gaze_is_as_captured_unless_it_is_told(eyed, files):
    """Both eyes were tracked looking ahead, and look elsewhere in the capture."""
    ahead = eyed(index=False)[0]
    rows = [(3, "eye_l", *yaw(12)), (3, "eye_r", *yaw(-7))]
    write_table(files / "index/gaze.parquet", pd.DataFrame(rows, columns=["frame", "eye", *"xyz"]))
    told = (0.6, 0.0, 0.8)
    code = "picture,code_0,code_1,code_2,code_3\n0,0,0,0,0\n"
    (files / "codes.csv").write_text(code)
    cases = [({}, (yaw(12), yaw(-7))), ({"gaze_direction": told}, (told, told))]
    for settings, directions in cases:
        for driven in ({}, {"codes": str(files / "codes.csv")}):
            found = eyed(**settings, **driven)[0]
            for eye, looks in enumerate(directions):
                own = of_eye(eye)
                np.testing.assert_allclose(found[own], turned(ahead[own], eye, looks), atol=FLOAT32_M)


BODY = {"avatar": "body", "deferred": "on"}


@pytest.mark.parametrize(
    ("row", "settings", "said"),
    [
        (BODY, {"codes": "codes.csv"}, "--codes: expected the avatar of a head, found that of a body"),
        (BODY, {"head_motion": "rest"}, "--head-motion: expected tracked for a body, found rest"),
        (BODY, {"gaze_direction": (0, 0, 1)}, "expected an avatar with explicit eyes, found one without"),
        ({}, {"gaze": "gaze.csv"}, "expected an avatar with explicit eyes, found one without"),
        ({}, {"gaze": "gaze.csv", "gaze_direction": (0, 0, 1)}, "either --gaze or --gaze-direction, found both"),
        ({}, {"segment": "c"}, r"--segment: expected one of .*index/frames.parquet: a, b; found c"),
        ({}, {"segment": "b", "last_frame": 2}, "expected tracked frames of segment b from 0 to 2, found 0, 1, 2,"),
        ({}, {"codes": "none.csv"}, "none.csv: expected a file, found none"),
        ({}, {"codes": "empty.csv"}, "empty.csv: table: expected at least one row, found none"),
        ({}, {"codes": "wide.csv"}, "wide.csv: expected the columns picture and code_0 to code_3, .* found picture"),
        ({}, {"codes": "words.csv"}, "words.csv: code_2: expected a finite number, found 'smile' in line 3"),
        ({}, {"codes": "twice.csv"}, "twice.csv: picture: expected each once, found repeated: 2"),
    ],
)  # fmt: skip
def test_what_cannot_be_driven_is_said_before_anything_is_written(files, monkeypatch, row, settings, said):
    head = "picture,code_0,code_1,code_2,code_3\n"
    tables = {
        "codes": head + "0,1,2,3,4\n", "empty": head, "wide": head.strip() + ",code_4\n0,1,2,3,4,5\n",
        "words": head + "0,1,2,3,4\n1,1,2,smile,4\n", "twice": head + "2,1,2,3,4\n" * 2,
        "gaze": "picture,eye,x,y,z\n0,eye_l,0,0,1\n",
    }  # fmt: skip
    for name, text in tables.items():
        (files / f"{name}.csv").write_text(text)
    monkeypatch.chdir(files)
    with pytest.raises(InputError, match=said):
        film(files, make_head(ATLAS, **row), "out", **settings)
    assert not (files / "out").exists()


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("0,eye_l,0,0,1\n0,eye_m,0,0,1\n0,eye_r,0,0,1\n", "eye: expected one that the avatar lists, found eye_m"),
        ("0,eye_l,0,0,1\n", "eye: expected directions of eye_l, eye_r, found none of eye_r"),
        ("0,eye_l,0,0,1\n0,eye_r,1,0,1\n", "x, y, z: expected a unit direction, found 'length 1.41' in line 3"),
        ("0,eye_l,0,0,1\n0,eye_r,0,0,1\n0,eye_l,0,0,1\n", "picture and eye: expected each once, found repeated: 0.0"),
    ],
)  # fmt: skip
def test_a_bad_table_of_gaze_is_told(eyed, files, rows, said):
    (files / "gaze.csv").write_text("picture,eye,x,y,z\n" + rows)
    with pytest.raises(InputError, match=said):
        eyed(gaze=str(files / "gaze.csv"))


@pytest.mark.parametrize("direction", [(0.0, 1.0), (0.0, 0.0, 2.0)])
def test_a_bad_direction_of_gaze_is_told(eyed, direction):
    with pytest.raises(InputError, match="--gaze-direction: expected three numbers, a unit direction, found"):
        eyed(gaze_direction=direction)


def test_a_direction_of_gaze_that_is_no_number_is_no_setting(eyed):
    with pytest.raises(ValidationError, match=r"gaze_direction\.2\s+Input should be a finite number"):
        eyed(gaze_direction=(0.0, 0.0, float("nan")))


def test_files_that_do_not_belong_together_are_told(files):
    save_avatar(files / "avatar", make_head(ATLAS), {})
    (files / "codes.csv").write_text("picture,code_0,code_1,code_2,code_3\n0,0,0,0,0\n")
    write_textures(files / "coarse.safetensors", np.arange(3), np.zeros((3, 7, 3)))
    chunk, other = files / "0000.safetensors", files / "textures_0001.safetensors"
    coded = RelightAvatar(codes=str(files / "codes.csv"))
    cases = [
        (
            {"tracking": (chunk,), "textures": (other, other)},
            RelightAvatar(),
            "--textures: expected one for each of 1 chun",
        ),
        ({"tracking": (chunk,), "textures": (other,)}, RelightAvatar(), "0000.safetensors, found those of 3, 4"),
        ({"tracking": (chunk,), "textures": (files / "coarse.safetensors",)}, RelightAvatar(), "64 texels, found 7"),
        ({"tracking": (chunk,)}, RelightAvatar(segment="a"), "--segment a: expected --index"),
        ({}, RelightAvatar(), "--tracking: expected at least one chunk of track_mesh, found none"),
        ({}, coded, "--codes with --head-motion rest does without"),
    ]
    for paths, settings, said in cases:
        with pytest.raises(InputError, match=said):
            stage.run(
                atlas=files / "atlas.safetensors", avatar=files / "avatar", lights=files / "lights.csv",
                out=files / "out", settings=settings, **paths,
            )  # fmt: skip
