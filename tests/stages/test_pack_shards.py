"""The packing stage on a tiny planted capture."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy.spatial.transform
from safetensors.numpy import load_file

from pipeline.base.errors import InputError
from pipeline.base.exr import write_exr
from pipeline.base.files import write_arrays
from pipeline.capture.images import write_png
from pipeline.capture.shards import read_frame_shards, read_image_shards
from pipeline.config.pack_shards import PackShards
from pipeline.geometry.cameras import Camera, write_cameras
from pipeline.geometry.texels import Atlas, write_atlas
from pipeline.stages.pack_shards import run
from tests.support.datasets.decodes import counted_decodes

FRAMES = [10, 11, 12, 13]
MAP = np.array([[9, 0.25], [0.5, 1]], np.float32)
SENSOR, DOWNSAMPLE = 64, 2
SIZE = SENSOR // DOWNSAMPLE
TINT = np.array([[0.5, 0.1, 0.0], [0.0, 1.2, 0.0], [0.1, 0.0, 2.0]])
HALF = 2.0**-10
"""Twice the relative rounding of float16: stored once, and one product in float32."""


def shown(camera: int, frame: int) -> np.ndarray:
    return np.random.default_rng([camera, frame]).uniform(0.1, 1, (SIZE, SIZE, 3)).astype(np.float16).astype(np.float32)


@pytest.fixture
def stage(tmp_path) -> Path:
    rows = []
    mask = np.zeros((SIZE, SIZE), np.uint8)
    mask[10:20, 8:25] = 255
    write_png(tmp_path / "mask.png", mask)
    for camera in (0, 1):
        for frame in FRAMES:
            write_exr(tmp_path / f"c{camera}/{frame}.exr", shown(camera, frame) + np.float32(0.25), half=False)
            flags = {"test_camera": camera == 1, "test_frame": frame == 11, "test_segment": False}
            flags["validation_camera"] = False
            files = {"path": f"c{camera}/{frame}.exr", "mask_path": "mask.png"}
            rows.append({"camera": f"c{camera}", "frame": frame, **files, **flags})
    (tmp_path / "index").mkdir()
    pd.DataFrame(rows).to_parquet(tmp_path / "index/images.parquet")
    pd.DataFrame({"frame": FRAMES[::-1]}).to_parquet(tmp_path / "index/frames.parquet")
    pd.DataFrame(columns=["frame", "eye", "x", "y", "z"]).to_parquet(tmp_path / "index/gaze.parquet")
    facts = {
        "kind": "body", "images": {"transfer": "linear", "black_level": 0.25, "downsample_from_sensor": DOWNSAMPLE}
    }  # fmt: skip
    (tmp_path / "index/capture.json").write_text(json.dumps(facts))
    K = np.array([[80.0, 0, 30], [0, 80, 34], [0, 0, 1]])
    camera = Camera(np.eye(3), np.array([0.0, 0, 2]), K, np.array([-0.6, 0, 0, 0, 0]), SENSOR, SENSOR)
    write_cameras(tmp_path / "cameras.json", {"c0": camera, "c1": camera})
    (tmp_path / "color.json").write_text(json.dumps({"cameras": {"c0": TINT.tolist(), "c1": np.eye(3).tolist()}}))
    # Two faces (one square), 2 x 2 texels of which three are valid.
    corners = np.array([[-0.2, -0.3, 0], [0.2, -0.3, 0], [0.2, 0.3, 0], [-0.2, 0.3, 0]], np.float32)
    texel, faces = np.array([[0, 1], [1, 0], [1, 1]]), np.array([[0, 1, 2], [0, 2, 3]])
    zeros, thirds = np.zeros(3, np.int32), np.full((3, 3), 1 / 3, np.float32)
    uv, weld = np.zeros((2, 3, 2), np.float32), np.arange(4)
    write_atlas(tmp_path / "atlas.safetensors", Atlas(2, faces, uv, weld, corners, texel, zeros, thirds, zeros, thirds))
    vertices = corners + np.arange(4, dtype=np.float32)[:, None, None] * 0.01
    write_arrays(tmp_path / "0000.safetensors", {"frames": np.array(FRAMES), "vertices": vertices})
    for i, frame in enumerate(FRAMES):
        write_exr(
            tmp_path / f"irradiance/{frame:06d}.exr", {"Y": MAP + np.diag([0, i]), "falling": MAP / 2, "error": 0 * MAP}
        )
    booked = {
        "frame": FRAMES[:3],
        "segment": "a",
        "fully_lit": [False, True, False],
        "test_pattern": False,
        "validation": False,
    }
    pd.DataFrame(booked).to_parquet(tmp_path / "frames.parquet")  # frame 13 was dropped by the bookkeeping
    lit = [(10, "B", 1.0), (11, "A", 2.0), (11, "B", 3.0)]
    patterns = pd.DataFrame([(f, n, i, i + 1, i + 2) for f, n, i in lit],
                            columns=["frame", "light", "intensity_r", "intensity_g", "intensity_b"])  # fmt: skip
    patterns.to_parquet(tmp_path / "patterns.parquet")
    lights = pd.DataFrame({"light": ["A", "B"], "x": [1.0, 2.0], "y": [0.0, 5.0], "z": [0.0, 7.0]})
    lights.to_parquet(tmp_path / "lights.parquet")
    return tmp_path


def pack(stage: Path, on: tuple[str, ...] = (), **flags) -> tuple:
    effects = {name: {"on": name in on} for name in ("shadow", "lens_distortion", "color_correction")}
    (stage / "effects.json").write_text(json.dumps(effects))
    files = {
        "tracking": "0000.safetensors",
        "atlas": "atlas.safetensors",
        "cameras": "cameras.json",
        "color": "color.json",
    }
    files |= {"effects": "effects.json", "patterns": "patterns.parquet", "frames": "frames.parquet"}
    paths = {flag: stage / name for flag, name in files.items()}
    irradiance = stage / "irradiance" if "shadow" in on else None
    options = {"irradiance": irradiance, "settings": PackShards(margin_px=2), **flags}
    run(capture=stage, index=stage / "index", lights=stage / "lights.parquet", out=stage / "shards", **paths, **options)
    shards = stage / "shards"
    return *(read_image_shards([shards / split]) for split in ("train", "test")), read_frame_shards([shards / "frames"])


def test_each_image_and_the_mask_that_all_share_are_decoded_once_whatever_their_splits(stage):
    with counted_decodes() as decoded:
        pack(stage)
    once = [f"c{camera}/{frame}.exr" for frame in FRAMES[:3] for camera in (0, 1)]
    assert [path for _, path in decoded.files if path.endswith(".exr")] == [str(stage / path) for path in once]
    assert [path for _, path in decoded.files if path.endswith(".png")] == [str(stage / "mask.png")]


@pytest.mark.parametrize("flag", ["test_camera", "test_frame", "test_segment"])
def test_image_of_any_held_out_kind_is_tested_and_never_trained_on(stage, flag):
    """One image per flag: that alone decides."""
    images = pd.read_parquet(stage / "index/images.parquet")
    chosen = (images.camera == "c0") & (images.frame == 12)
    images = images.assign(test_camera=False, test_frame=False, test_segment=False).assign(**{flag: chosen})
    images.to_parquet(stage / "index/images.parquet")
    train, test, _ = pack(stage)
    assert [(r.camera, r.frame) for r in test] == [("c0", 12)]
    assert ("c0", 12) not in [(r.camera, r.frame) for r in train] and len(train) == 5


def test_every_frame_of_a_held_out_pattern_is_held_out(stage):
    booked = pd.read_parquet(stage / "frames.parquet")
    booked.assign(test_pattern=booked.frame == 12).to_parquet(stage / "frames.parquet")
    train, test, _ = pack(stage)
    assert [(r.camera, r.frame) for r in train] == [("c0", 10)]
    assert [(r.camera, r.frame) for r in test if r.test_pattern] == [("c0", 12), ("c1", 12)]
    assert all(r.is_test for r in test)


def test_validation_images_have_shards_of_their_own_and_are_never_test_images(stage):
    booked = pd.read_parquet(stage / "frames.parquet")
    booked.assign(validation=booked.frame.isin([11, 12])).to_parquet(stage / "frames.parquet")
    train, test, _ = pack(stage)
    (validation,) = read_image_shards([stage / "shards/validation"])
    assert (validation.camera, validation.frame, validation.validation, validation.is_test) == ("c0", 12, True, False)
    assert [(r.camera, r.frame) for r in train] == [("c0", 10)]
    assert [(r.camera, r.frame) for r in test] == [("c1", 10), ("c0", 11), ("c1", 11), ("c1", 12)]
    assert not any(r.validation for r in [*train, *test])


def test_with_all_effects_off_crops_are_the_images(stage):
    train, test, frames = pack(stage)
    assert [(r.camera, r.frame) for r in train] == [("c0", 10), ("c0", 12)]
    assert [(r.camera, r.frame) for r in test] == [("c1", 10), ("c0", 11), ("c1", 11), ("c1", 12)]
    record = test[1]
    assert (record.test_camera, record.test_frame, record.test_segment, record.fully_lit) == (False, True, False, True)
    assert (record.x0, record.y0, record.width, record.height) == (6, 8, 21, 14)
    np.testing.assert_allclose(record.image, shown(0, 11)[8:22, 6:27], rtol=HALF)
    assert record.mask.sum() == 170
    assert record.mask[2:12, 2:19].all()
    # Intrinsics divide by the downsampling, then the crop moves the principal point.
    np.testing.assert_allclose(record.K, [[40, 0, 15 - 6], [0, 40, 17 - 8], [0, 0, 1]])
    np.testing.assert_array_equal(record.t, [0, 0, 2])
    assert sorted(frames) == [10, 11, 12]
    assert (frames[11].irradiance == 1).all()


def test_frames_carry_light_and_geometry(stage):
    _, _, frames = pack(stage, on=("shadow",))
    np.testing.assert_array_equal(frames[11].light_positions, [[1, 0, 0], [2, 5, 7]])
    np.testing.assert_array_equal(frames[11].light_intensities, [[2, 3, 4], [3, 4, 5]])
    assert frames[10].light_positions.shape == (1, 3)
    assert frames[12].light_positions.shape == (0, 3)
    assert (frames[11].segment, frames[11].fully_lit, frames[10].fully_lit) == ("a", True, False)
    np.testing.assert_array_equal(frames[12].irradiance, [0.25, 0.5, 3])  # texels (0,1), (1,0), (1,1) of frame 12's map
    np.testing.assert_array_equal(frames[12].cosine_visibility, [0.125, 0.25, 0.5])
    np.testing.assert_allclose(frames[12].vertices[0], [-0.2 + 0.02, -0.3 + 0.02, 0.02], rtol=1e-6)


def test_frames_alone_take_other_maps_and_leave_the_images(stage):
    pack(stage, on=("shadow",))
    for frame in FRAMES:
        write_exr(stage / f"other/{frame:06d}.exr", {"Y": MAP + 1, "falling": MAP, "error": 0 * MAP})
        for camera in (0, 1):
            (stage / f"c{camera}/{frame}.exr").unlink()  # so that no image can be packed
    train, _, frames = pack(stage, on=("shadow",), only_frames=True, irradiance=stage / "other")
    assert len(train) == 2
    np.testing.assert_array_equal(frames[12].irradiance, [1.25, 1.5, 2])


def test_colors_are_corrected_per_camera(stage):
    train, test, _ = pack(stage, on=("color_correction",))
    np.testing.assert_allclose(train[0].image, shown(0, 10)[8:22, 6:27] @ TINT.T, rtol=4 * HALF)
    np.testing.assert_allclose(test[0].image, shown(1, 10)[8:22, 6:27], rtol=HALF)


def test_lens_distortion_moves_image_and_mask(stage):
    straight, _, _ = pack(stage, on=("lens_distortion",))
    assert (straight[0].x0, straight[0].y0, straight[0].width, straight[0].height) != (6, 8, 21, 14)
    assert straight[0].mask.sum() > 170  # a barrel lens shows things smaller than a pinhole does


def test_without_masks_the_mesh_is_the_silhouette(stage):
    images = pd.read_parquet(stage / "index/images.parquet").assign(mask_path=None)
    images.to_parquet(stage / "index/images.parquet")
    train, _, _ = pack(stage)
    # The square spans 40 px/m x 0.4 m / 2 m = 8 by 12 pixels around (15, 17); frame 10 is tracked as it is at rest.
    assert (train[0].x0 + 2, train[0].y0 + 2, train[0].width - 4, train[0].height - 4) == (11, 11, 8, 12)
    assert train[0].mask.sum() == 8 * 12


def test_a_head_has_its_motion_gaze_and_texture(stage):
    facts = json.loads((stage / "index/capture.json").read_text())
    (stage / "index/capture.json").write_text(json.dumps(facts | {"kind": "head"}))
    turn = scipy.spatial.transform.Rotation.random(len(FRAMES), rng=3)
    shift = np.random.default_rng(4).normal(size=(len(FRAMES), 3))
    tracked = load_file(stage / "0000.safetensors")
    tracked["root_rotation"] = turn.as_quat(scalar_first=True).astype(np.float32)
    write_arrays(stage / "0000.safetensors", {**tracked, "root_translation": shift.astype(np.float32)})
    looks = [(f, eye, *v) for f in FRAMES for eye, v in (("right", (1.0, 0.0, f)), ("left", (0.0, 1.0, f)))]
    pd.DataFrame(looks, columns=["frame", "eye", "x", "y", "z"]).to_parquet(stage / "index/gaze.parquet")
    textures = np.random.default_rng(5).uniform(size=(len(FRAMES), 3, 3)).astype(np.float16)
    write_arrays(stage / "textures.safetensors", {"frames": np.array(FRAMES), "textures": textures})
    _, _, frames = pack(stage, textures=stage / "textures.safetensors")
    point = np.array([0.1, 0.2, 0.3])
    for i, frame in enumerate(FRAMES[:3]):
        moved = turn[i].apply(point) + shift[i]
        motion = frames[frame].head_from_world
        np.testing.assert_allclose(motion[:, :3] @ moved + motion[:, 3], point, atol=1e-6)  # float32 of about 1
        np.testing.assert_array_equal(frames[frame].gaze, [[0, 1, frame], [1, 0, frame]])  # left before right
        np.testing.assert_array_equal(frames[frame].texture, textures[i].astype(np.float32))
    write_arrays(stage / "textures.safetensors", {"frames": np.array(FRAMES[:2]), "textures": textures[:2]})
    with pytest.raises(InputError, match="frame 12: expected a mean texture"):
        pack(stage, textures=stage / "textures.safetensors")
    write_arrays(stage / "textures.safetensors", {"frames": np.array(FRAMES)})
    with pytest.raises(InputError, match="run bake_textures again"):
        pack(stage, textures=stage / "textures.safetensors")


def test_a_body_has_none_of_that(stage):
    _, _, frames = pack(stage)
    assert (frames[10].head_from_world, frames[10].gaze, frames[10].texture) == (None, None, None)


def test_chunks_partition_the_frames(stage):
    for chunk in (0, 1):
        pack(stage, chunk=chunk, chunk_size=2)
    shards = stage / "shards"
    assert [sorted(read_frame_shards([shards / f"frames/000{c}.arrow"])) for c in (0, 1)] == [[10, 11], [12]]
    assert len(read_image_shards([shards / "train", shards / "test"])) == 6


def test_images_without_subject_are_left_out(stage, caplog):
    write_png(stage / "mask.png", np.zeros((SIZE, SIZE), np.uint8))
    train, test, frames = pack(stage)
    assert (len(train), len(test), len(frames)) == (0, 0, 3)
    assert "no foreground" in caplog.text


def test_everything_missing_is_named_at_once(stage):
    arrays = {"frames": np.array([10]), "vertices": np.zeros((1, 4, 3), np.float32)}
    write_arrays(stage / "0000.safetensors", arrays)
    pd.DataFrame({"light": ["A"], "x": [1.0], "y": [0.0], "z": [0.0]}).to_parquet(stage / "lights.parquet")
    (stage / "color.json").write_text('{"cameras": {}}')
    (stage / "irradiance/000012.exr").unlink()
    with pytest.raises(InputError) as error:
        pack(stage, on=("shadow", "color_correction"))
    for part in ("c0", "c1", "frame 11: expected tracked", "frame 12: expected a map", "B: expected a position"):
        assert part in str(error.value)
    assert not (stage / "shards").exists()
