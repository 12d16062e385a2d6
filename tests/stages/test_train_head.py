"""The stage on frames of a head: what the capture is of decides, a stop changes nothing, and fewer images train."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

import pipeline.stages.train_avatar as stage
from pipeline.avatar.training.checkpoint import load_avatar
from pipeline.avatar.training.training import Training
from pipeline.base.errors import InputError
from pipeline.base.files import read_arrays, read_json
from pipeline.capture.shards import read_frame_shards, write_frame_shard
from pipeline.config.train_avatar import TrainAvatar
from tests.support.avatars.sheet_subject import stage_arguments, write_subject

SMALL = {"code_size": 4, "decoder_channels": (8, 4), "pose_points": 4}
SETTINGS = TrainAvatar(steps=6, checkpoint_every=2, log_every=1, deferred="off", weight_ssim=0.02, **SMALL)


@pytest.fixture
def inputs(tmp_path):
    """The sheet as a head: every frame is bent a little further, and says how the head moved."""
    write_subject(tmp_path)
    given = {**stage_arguments(tmp_path), "settings": SETTINGS, "processes": 1}
    frames = []
    for number, frame in read_frame_shards([given["shards"] / "frames"]).items():
        vertices = frame.vertices.copy()
        vertices[1, 2] += 0.02 * number
        texture = np.full((len(frame.irradiance), 3), 0.3 + 0.05 * number, np.float32)
        motion = np.eye(3, 4, dtype=np.float32)
        frames.append(dataclasses.replace(frame, vertices=vertices, head_from_world=motion, texture=texture))
    write_frame_shard(given["shards"] / "frames/0000.arrow", frames)
    return given


def changed(inputs, **settings):
    return inputs | {"settings": SETTINGS.model_copy(update=settings)}


def test_frames_of_a_head_make_the_avatar_of_a_head(inputs, tmp_path):
    stage.run(**inputs, out=tmp_path / "auto")
    spec = load_avatar(tmp_path / "auto", inputs["atlas"]).avatar.spec
    assert spec.head and spec.shading == "subsurface"
    log = pd.read_parquet(tmp_path / "auto/log.parquet")
    assert {"kl", "geometry", "ssim"} <= set(log.columns)
    assert log.photometric.iloc[-2:].mean() < log.photometric.iloc[:2].mean()
    stage.run(**changed(inputs, avatar="body"), out=tmp_path / "body")
    body = read_json(tmp_path / "body/config.json")
    assert body["spec"]["avatar"] == "body" and not any(
        "networks" in n for n in read_arrays(tmp_path / "body/avatar.safetensors")
    )
    assert "kl" not in pd.read_parquet(tmp_path / "body/log.parquet").columns


def test_a_stopped_run_goes_on_to_the_same_bits(inputs, tmp_path, monkeypatch):
    class Death(Exception):
        pass

    stage.run(**inputs, out=tmp_path / "whole")
    take_round = Training.take_round

    def dies(self, first, *rest):
        if first == 4:
            raise Death
        return take_round(self, first, *rest)

    monkeypatch.setattr(Training, "take_round", dies)
    with pytest.raises(Death):
        stage.run(**inputs, out=tmp_path / "stopped")
    monkeypatch.setattr(Training, "take_round", take_round)
    stage.run(**inputs, out=tmp_path / "stopped")
    whole, stopped = (read_arrays(tmp_path / name / "avatar.safetensors") for name in ("whole", "stopped"))
    for name in whole:
        np.testing.assert_array_equal(whole[name], stopped[name], err_msg=name)


def test_fewer_cameras_are_what_it_learns_from(inputs, tmp_path, monkeypatch):
    seen, take_round = set(), Training.take_round

    def watched(self, first, portions, *rest):
        seen.update(image.camera for portion in portions for image in portion.images)
        return take_round(self, first, portions, *rest)

    monkeypatch.setattr(Training, "take_round", watched)
    stage.run(**inputs, out=tmp_path / "all")
    every = set(seen)
    seen.clear()
    stage.run(**changed(inputs, cameras=1), out=tmp_path / "one")
    assert len(every) > 1 and len(seen) == 1
    with pytest.raises(InputError, match="cameras: expected at most"):
        stage.run(**changed(inputs, cameras=99), out=tmp_path / "many")


def test_frame_without_a_training_image_leaves_every_buffer_as_it_is(inputs, tmp_path):
    """A test frame of a grimace: no mean, component or length of the encoder knows of it."""
    inputs = changed(inputs, steps=1)
    stage.run(**inputs, out=tmp_path / "before")
    frames = list(read_frame_shards([inputs["shards"] / "frames"]).values())
    grimace = dataclasses.replace(
        frames[0], frame=99, vertices=frames[0].vertices + np.float32([0, 0, 0.5]), texture=9 * frames[0].texture
    )
    write_frame_shard(inputs["shards"] / "frames/0000.arrow", [*frames, grimace])
    stage.run(**inputs, out=tmp_path / "after")
    before, after = (read_arrays(tmp_path / name / "avatar.safetensors") for name in ("before", "after"))
    assert before.keys() == after.keys()
    for name in before:
        np.testing.assert_array_equal(before[name], after[name], err_msg=name)
