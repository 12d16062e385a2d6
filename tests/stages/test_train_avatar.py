"""The stage from shards to an avatar, without Snakemake: what is off is not built, and a stop changes nothing."""

import json
from dataclasses import replace

import numpy as np
import pytest

import pipeline.train_avatar as stage
from pipeline.avatar.checkpoint import load_avatar
from pipeline.base.errors import InputError
from pipeline.base.files import read_arrays, write_arrays
from pipeline.capture.shards import read_frame_shards, write_frame_shard, write_image_shard
from pipeline.config.effects import EFFECTS
from pipeline.config.train_avatar import TrainAvatar
from pipeline.geometry.texels import write_atlas
from tests.unit.avatar.sheet import make_frame, make_image, make_sheet

SETTINGS = TrainAvatar(steps=6, checkpoint_every=2, log_every=1)


@pytest.fixture
def inputs(tmp_path):
    atlas = make_sheet(8)
    lights = [[0.5, 0.3, 1.5], [-0.6, 0.0, 1.2]]
    frames = [make_frame(atlas, np.array([light]), np.full((1, 3), 3.0), i) for i, light in enumerate(lights)]
    images = [make_image(frame, np.array([0.7, 0.4, 0.2]), shift) for frame in frames for shift in (-0.2, 0.2)]
    write_atlas(tmp_path / "atlas.safetensors", atlas)
    write_frame_shard(tmp_path / "shards/frames/0000.arrow", frames)
    write_image_shard(tmp_path / "shards/train/0000.arrow", images)
    (tmp_path / "effects.json").write_text(json.dumps({name: {"on": name != "shadow"} for name in EFFECTS}))
    return {
        "subject": "sheet", "atlas": tmp_path / "atlas.safetensors", "shards": tmp_path / "shards",
        "effects": tmp_path / "effects.json", "settings": SETTINGS,
    }  # fmt: skip


def test_avatar_has_what_the_plan_asks_for_and_loads(inputs, tmp_path):
    stage.run(**inputs, out=tmp_path / "off")
    assert not any("shadow" in name for name in read_arrays(tmp_path / "off/avatar.safetensors"))
    assert not (tmp_path / "off/checkpoint.safetensors").exists()
    assert len(load_avatar(tmp_path / "off", inputs["atlas"]).avatar.albedo) == 64
    inputs["effects"].write_text(json.dumps({name: {"on": True} for name in EFFECTS}))
    with pytest.raises(InputError, match="expected traced shadows, found none"):
        stage.run(**inputs, out=tmp_path / "on")
    shadowed = [
        replace(frame, irradiance=frame.irradiance / 2)
        for frame in read_frame_shards([inputs["shards"] / "frames"]).values()
    ]
    write_frame_shard(inputs["shards"] / "frames/0000.arrow", shadowed)
    stage.run(**inputs, out=tmp_path / "on")
    assert any("shadow" in name for name in read_arrays(tmp_path / "on/avatar.safetensors"))


def test_a_stopped_run_goes_on_to_the_same_bits(inputs, tmp_path, monkeypatch):
    stage.run(**inputs, out=tmp_path / "whole")
    seen = []

    def stop_at_five(step, *rest):
        seen.append(step)
        if len(seen) == 5:
            raise KeyboardInterrupt
        return stage_step(step, *rest)

    stage_step = stage.take_step
    monkeypatch.setattr(stage, "take_step", stop_at_five)
    with pytest.raises(KeyboardInterrupt):
        stage.run(**inputs, out=tmp_path / "stopped")
    stage.run(**inputs, out=tmp_path / "stopped")
    assert seen == [0, 1, 2, 3, 4, 4, 5]
    whole, stopped = (read_arrays(tmp_path / name / "avatar.safetensors") for name in ("whole", "stopped"))
    for name in whole:
        np.testing.assert_array_equal(whole[name], stopped[name], err_msg=name)


def test_an_avatar_of_another_version_is_told(inputs, tmp_path):
    stage.run(**inputs, out=tmp_path / "avatar")
    arrays = read_arrays(tmp_path / "avatar/avatar.safetensors")
    write_arrays(tmp_path / "avatar/avatar.safetensors", {**arrays, "lambert": np.zeros(9, np.float32)})
    with pytest.raises(InputError, match=r"avatar\.safetensors: expected the tensors of this version"):
        load_avatar(tmp_path / "avatar", inputs["atlas"])
    config = json.loads((tmp_path / "avatar/config.json").read_text())
    del config["spec"]["deferred"]
    (tmp_path / "avatar/config.json").write_text(json.dumps(config))
    with pytest.raises(InputError, match="keys of this version"):
        load_avatar(tmp_path / "avatar", inputs["atlas"])


def test_no_training_image_is_told(inputs, tmp_path):
    write_image_shard(inputs["shards"] / "train/0000.arrow", [])
    with pytest.raises(InputError, match="training images"):
        stage.run(**inputs, out=tmp_path / "none")
