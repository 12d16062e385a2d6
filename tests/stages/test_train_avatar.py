"""The stage from shards to an avatar, without Snakemake: what is off is not built, and a stop changes nothing."""

import dataclasses
import json
import os
import re
import signal
import warnings
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pandas as pd
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

import pipeline.avatar.frames.inputs as inputs_module
import pipeline.avatar.training.loop as loop
import pipeline.stages.train_avatar as stage
from pipeline.avatar.spec.planned import resolve_spec
from pipeline.avatar.training.checkpoint import load_avatar
from pipeline.avatar.training.training import Training
from pipeline.avatar.training.training_images import Schedule
from pipeline.avatar.training.training_log import MOST_PREVIEWS, preview_spacing
from pipeline.base.color import srgb_from_linear
from pipeline.base.errors import InputError
from pipeline.base.files import read_arrays, write_arrays
from pipeline.base.splits import TEST_FLAGS, VALIDATION
from pipeline.base.stopping import Stopped
from pipeline.capture.shards import (
    FrameShards,
    read_frame_shards,
    read_image_shards,
    write_frame_shard,
    write_image_shard,
)
from pipeline.config.effects import EFFECTS
from pipeline.config.train_avatar import TrainAvatar
from pipeline.geometry.texels import write_atlas
from tests.support.avatars.sheet import make_frame, make_sheet
from tests.support.avatars.sheet_subject import sheet_frames, sheet_images, stage_arguments, write_subject

SETTINGS = TrainAvatar(shading="transfer", deferred="on", steps=6, steps_together=1, checkpoint_every=2, log_every=1)


@pytest.fixture
def inputs(tmp_path):
    write_subject(tmp_path)
    return {**stage_arguments(tmp_path), "settings": SETTINGS}


def test_avatar_has_what_the_plan_asks_for_and_loads(inputs, tmp_path):
    stage.run(**inputs, out=tmp_path / "off")
    assert not any("shadow" in name for name in read_arrays(tmp_path / "off/avatar.safetensors"))
    assert not (tmp_path / "off/checkpoint.safetensors").exists()
    assert len(load_avatar(tmp_path / "off", inputs["atlas"]).avatar.albedo) == 64
    inputs["effects"].write_text(json.dumps({name: {"on": name != "eyes"} for name in EFFECTS}))
    with pytest.raises(InputError, match="expected traced shadows, found none"):
        stage.run(**inputs, out=tmp_path / "on")
    shadowed = [
        dataclasses.replace(frame, irradiance=frame.irradiance / 2)
        for frame in read_frame_shards([inputs["shards"] / "frames"]).values()
    ]
    write_frame_shard(inputs["shards"] / "frames/0000.arrow", shadowed)
    stage.run(**inputs, out=tmp_path / "on")
    assert any("shadow" in name for name in read_arrays(tmp_path / "on/avatar.safetensors"))


def test_eyes_that_are_on_ask_for_their_fit(inputs, tmp_path):
    settings = SETTINGS.model_copy(update={"eyes": "on"})
    with pytest.raises(InputError, match=r"--fitted-eyes: expected eyes.json of fit_eyes, as eyes are on, found none"):
        stage.run(**{**inputs, "settings": settings}, out=tmp_path / "avatar")


def test_frames_with_other_irradiance_are_what_it_learns_from(inputs, tmp_path):
    inputs["effects"].write_text(json.dumps({name: {"on": name != "eyes"} for name in EFFECTS}))
    dimmed = [
        dataclasses.replace(frame, irradiance=0.5 * frame.irradiance, cosine_visibility=0.3 * frame.cosine_visibility)
        for frame in read_frame_shards([tmp_path / "shards/frames"]).values()
    ]
    write_frame_shard(tmp_path / "dim/0000.arrow", dimmed)
    stage.run(**inputs, out=tmp_path / "own", frames=tmp_path / "dim")
    write_frame_shard(tmp_path / "shards/frames/0000.arrow", dimmed)
    stage.run(**inputs, out=tmp_path / "default")
    own, default = (read_arrays(tmp_path / name / "avatar.safetensors") for name in ("own", "default"))
    for name in own:
        np.testing.assert_array_equal(own[name], default[name], err_msg=name)


@pytest.mark.parametrize("flag", [*TEST_FLAGS, VALIDATION])
def test_held_out_image_among_training_images_is_refused(inputs, tmp_path, flag):
    path = inputs["shards"] / "train/0000.arrow"
    records = list(read_image_shards([path]))
    write_image_shard(path, [dataclasses.replace(records[0], **{flag: True}), *records[1:]])
    said = rf"train: expected no held-out images, found {records[0].camera}/{records[0].frame} \({flag}\)"
    with pytest.raises(InputError, match=said):
        stage.run(**inputs, out=tmp_path / "avatar")
    assert not (tmp_path / "avatar/avatar.safetensors").exists()


class Death(Exception):
    """Ends a run where it stands, as SIGKILL does."""


def step_and(monkeypatch, number, action):
    """Do `action` once when the round `number` is over; returns the list of their first steps."""
    taken, take_round = [], Training.take_round

    def step(self, first, *rest):
        done = take_round(self, first, *rest)
        taken.append(first)
        if len(taken) == number + 1:
            action()
        return done

    monkeypatch.setattr(Training, "take_round", step)
    return taken


def die():
    raise Death


def same_avatars(*folders):
    first, second = (read_arrays(folder / "avatar.safetensors") for folder in folders)
    assert first.keys() == second.keys()
    for name in first:
        np.testing.assert_array_equal(first[name], second[name], err_msg=name)


def test_a_killed_run_goes_on_to_the_same_bits(inputs, tmp_path, monkeypatch):
    stage.run(**inputs, out=tmp_path / "whole")
    taken = step_and(monkeypatch, 4, die)
    with pytest.raises(Death):
        stage.run(**inputs, out=tmp_path / "stopped")
    stage.run(**inputs, out=tmp_path / "stopped")
    assert taken == [0, 1, 2, 3, 4, 4, 5]
    same_avatars(tmp_path / "whole", tmp_path / "stopped")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_the_run_after_its_step(inputs, tmp_path, monkeypatch, number):
    """Without waiting for a checkpoint's turn; a second signal hurries nothing, and the old handlers come back."""
    stage.run(**inputs, out=tmp_path / "whole")
    handlers = signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)

    def signal_twice():
        os.kill(os.getpid(), number)
        os.kill(os.getpid(), signal.SIGTERM)

    taken = step_and(monkeypatch, 2, signal_twice)
    with pytest.raises(Stopped, match="stopped after 4 of 6 steps") as stopped:
        stage.run(**inputs, out=tmp_path / "stopped")
    assert stopped.value.number == number
    assert (signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)) == handlers
    assert not (tmp_path / "stopped/avatar.safetensors").exists()
    stage.run(**inputs, out=tmp_path / "stopped")
    assert taken == [0, 1, 2, 3, 4, 5]
    same_avatars(tmp_path / "whole", tmp_path / "stopped")
    tables = [pd.read_parquet(tmp_path / name / "log.parquet").drop(columns="seconds") for name in ("whole", "stopped")]
    pd.testing.assert_frame_equal(*tables)


@pytest.mark.parametrize("choices", [{}, {"shading": "microfacet", "visibility": "traced", "indirect": "bounce"}])
def test_frames_that_are_not_kept_are_read_again_to_the_same_bits(tmp_path, monkeypatch, choices):
    """Six frames of which no more than two are in use at a time; lights are refined on the way."""
    places = [[0.5 - 0.2 * number, 0.3, 1.5] for number in range(6)]
    frames = [make_frame(make_sheet(8), np.array([place]), np.full((1, 3), 3.0), i) for i, place in enumerate(places)]
    frames = [dataclasses.replace(frame, fully_lit=False) for frame in frames]
    write_subject(tmp_path, sheet_images(frames), shadow=True)
    shaded = [dataclasses.replace(frame, irradiance=0.5 * frame.irradiance) for frame in frames]
    write_frame_shard(tmp_path / "shards/frames/0000.arrow", shaded)
    read, get = [], FrameShards.__getitem__
    monkeypatch.setattr(FrameShards, "__getitem__", lambda self, frame: read.append(frame) or get(self, frame))
    settings, reads = SETTINGS.model_copy(update={"steps": 14, **choices}), []
    traced, trace = [], inputs_module.trace_bits
    monkeypatch.setattr(inputs_module, "trace_bits", lambda *given: traced.append(1) or trace(*given))
    for name, cache_mb, scratch in (("all", 1000, None), ("none", 0, None), ("disk", 0, tmp_path / "scratch")):
        read.clear(), traced.clear()
        stage.run(
            **stage_arguments(tmp_path), settings=settings, cache_mb=cache_mb, scratch=scratch, out=tmp_path / name
        )
        reads.append((read.count(5), len(traced)))
    assert reads[0][0] == 2  # once for its inputs, once for the places of the lights that are refined
    assert reads[1][0] >= 4 and reads[2][0] >= 4
    assert [count for _, count in reads[::2]] == [len(frames) * bool(choices)] * 2  # the disk has what was traced
    assert (reads[1][1] > len(frames)) == bool(choices)
    assert not list((tmp_path / "scratch").iterdir())
    for name in ("none", "disk"):
        for file in ("avatar.safetensors", "config.json", "previews/step_000013.png"):
            assert (tmp_path / "all" / file).read_bytes() == (tmp_path / name / file).read_bytes(), (name, file)
        tables = [pd.read_parquet(tmp_path / run / "log.parquet").drop(columns="seconds") for run in ("all", name)]
        pd.testing.assert_frame_equal(*tables)


def test_a_run_killed_between_rounds_goes_on_to_the_same_bits(inputs, tmp_path, monkeypatch):
    """Rounds of 2 with a checkpoint every 3 steps: one is written after the round in which it falls due."""
    rounds = {
        **inputs,
        "settings": SETTINGS.model_copy(update={"steps": 7, "steps_together": 2, "checkpoint_every": 3}),
    }
    stage.run(**rounds, out=tmp_path / "whole")
    taken = step_and(monkeypatch, 2, die)
    with pytest.raises(Death):
        stage.run(**rounds, out=tmp_path / "stopped")
    stage.run(**rounds, out=tmp_path / "stopped")
    assert taken == [0, 2, 4, 4, 6]
    same_avatars(tmp_path / "whole", tmp_path / "stopped")
    assert pd.read_parquet(tmp_path / "stopped/log.parquet").step.tolist() == list(range(7))


def test_seconds_add_up_over_runs(inputs, tmp_path, monkeypatch):
    step_and(monkeypatch, 3, die)
    monkeypatch.setattr(loop, "time", SimpleNamespace(monotonic=iter(range(0, 10_000, 100)).__next__))
    with pytest.raises(Death):
        stage.run(**inputs, out=tmp_path / "out")
    stage.run(**inputs, out=tmp_path / "out")
    # The clock moves by 100 s whenever it is read, which is once at the start of a run and once after each step.
    assert pd.read_parquet(tmp_path / "out/log.parquet").seconds.tolist() == [100, 200, 300, 400, 500, 600]
    assert "seconds" not in json.loads((tmp_path / "out/config.json").read_text())  # which is the same every time


def test_how_it_is_watched_does_not_void_a_checkpoint(inputs, tmp_path, monkeypatch):
    taken = step_and(monkeypatch, 4, die)
    with pytest.raises(Death):
        stage.run(**inputs, out=tmp_path / "out")
    watched = SETTINGS.model_copy(update={"preview_every": 0, "device": "cpu", "checkpoint_every": 5})
    stage.run(**{**inputs, "settings": watched}, out=tmp_path / "out")
    assert taken == [0, 1, 2, 3, 4, 4, 5]
    spec = resolve_spec(SETTINGS, set())
    other = SETTINGS.model_copy(update={"weight_mask": 0.2})
    assert stage.fingerprint_of(other, spec, []) != stage.fingerprint_of(SETTINGS, spec, [])


def test_every_setting_that_matters_voids_a_checkpoint():
    """Even the number of steps, which the rates' fall follows."""
    spec, fingerprints = resolve_spec(SETTINGS, set()), {}
    for name in TrainAvatar.model_fields:
        changed = SETTINGS.model_copy(update={name: f"not {getattr(SETTINGS, name)!r}"})
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # pydantic's, of values that no field would take.
            fingerprints[name] = stage.fingerprint_of(changed, spec, [])
    same = stage.fingerprint_of(SETTINGS, spec, [])
    watched = {"checkpoint_every", "log_every", "preview_every", "device"}  # how often one looks, and where it runs
    assert {name for name, found in fingerprints.items() if found == same} == watched


def test_checkpoint_of_older_code_is_not_used(inputs, tmp_path, monkeypatch):
    """Half of a training by one code and half by another ends where neither does from the start."""
    taken = step_and(monkeypatch, 4, die)
    with pytest.raises(Death):
        stage.run(**inputs, out=tmp_path / "out")
    monkeypatch.setattr(stage, "code_digest", lambda module: f"{module}, edited")
    stage.run(**inputs, out=tmp_path / "out")
    assert taken == [0, 1, 2, 3, 4, 0, 1, 2, 3, 4, 5]


@pytest.mark.parametrize("read", ["shards/train/0000.arrow", "shards/frames/0000.arrow", "atlas.safetensors"])
def test_checkpoint_of_other_inputs_is_not_used(inputs, tmp_path, monkeypatch, read):
    taken = step_and(monkeypatch, 4, die)
    with pytest.raises(Death):
        stage.run(**inputs, out=tmp_path / "out")
    path, digest = tmp_path / read, stage.digest_file
    assert path.exists()
    # As if the content were another: every file that is read counts.
    monkeypatch.setattr(stage, "digest_file", lambda file: digest(file) + "x" * (Path(file) == path))
    stage.run(**inputs, out=tmp_path / "out")
    assert taken == [0, 1, 2, 3, 4, 0, 1, 2, 3, 4, 5]


def test_a_pixel_that_is_not_finite_is_traced_to_its_step(tmp_path, monkeypatch):
    """The message has the step, its images, the term, and a state: that of a clean capture before that step."""
    settings = SETTINGS.model_copy(update={"checkpoint_every": 1})
    images = sheet_images(sheet_frames())
    frame_of_image = [image.frame for image in images]
    first = Schedule("sheet", frame_of_image, settings.cameras_per_step, settings.steps_together)[0][0]
    chosen = next(index for index, frame in enumerate(frame_of_image) if frame != frame_of_image[first])
    spoiled = images[chosen].image.copy()
    spoiled[12, 12] = np.nan
    broken = [*images[:chosen], dataclasses.replace(images[chosen], image=spoiled), *images[chosen + 1 :]]
    for name, content in (("clean", images), ("spoiled", broken)):
        (tmp_path / name).mkdir()
        write_subject(tmp_path / name, content)
    with pytest.raises(InputError) as told:
        stage.run(**stage_arguments(tmp_path / "spoiled"), settings=settings, out=tmp_path / "out")
    found = re.fullmatch(
        r"step (\d), (.*): expected finite numbers, found others in loss terms: photometric \(nan\).*; before it: (.*)",
        str(told.value),
    )
    assert found, told.value
    assert set(found[2].split(", ")) == {f"x{x}/{frame_of_image[chosen]}" for x in (-0.2, 0.2)}
    number = int(found[1])
    assert number > 0
    step_and(monkeypatch, number, die)
    with pytest.raises(Death):
        stage.run(**stage_arguments(tmp_path / "clean"), settings=settings, out=tmp_path / "clean/out")
    before, expected = read_arrays(Path(found[3])), read_arrays(tmp_path / "clean/out/checkpoint.safetensors")
    assert before["adam.step.albedo"] == number
    for name in expected:
        np.testing.assert_array_equal(before[name], expected[name], err_msg=name)


def test_previews_are_few_and_show_the_capture(inputs, tmp_path):
    settings = SETTINGS.model_copy(update={"steps": 7, "log_every": 2, "preview_every": 3})
    (tmp_path / "out/previews").mkdir(parents=True)
    (tmp_path / "out/previews/step_000500.png").write_text("of an earlier training")
    stage.run(**{**inputs, "settings": settings}, out=tmp_path / "out")
    found = sorted(path.name for path in (tmp_path / "out/previews").iterdir())
    assert found == ["step_000000.png", "step_000004.png", "step_000006.png"]
    picture = cv2.imread(str(tmp_path / "out/previews/step_000006.png"))[..., ::-1] / 255
    captured = picture[44 + 36, 36]  # The middle of the sheet: 3 x 3 pixels for one, under two lines of text.
    image = sheet_images(sheet_frames())[2]
    np.testing.assert_allclose(captured, srgb_from_linear(image.image[12, 12]), atol=1 / 255)
    assert preview_spacing(TrainAvatar(steps=100_000)) == 100_000 / MOST_PREVIEWS
    assert preview_spacing(TrainAvatar(preview_every=0)) == 0


def test_tensorboard_has_curves_and_pictures(inputs, tmp_path):
    stage.run(**inputs, out=tmp_path / "out")
    events = EventAccumulator(str(tmp_path / "out/events"))
    events.Reload()
    assert {"loss", "loss/photometric", "loss/offset"} <= set(events.Tags()["scalars"])
    assert [event.step for event in events.Scalars("loss")] == list(range(6))
    assert [event.step for event in events.Images("preview")] == [0, 5]


def test_an_avatar_of_another_version_is_told(inputs, tmp_path):
    stage.run(**inputs, out=tmp_path / "avatar")
    arrays = read_arrays(tmp_path / "avatar/avatar.safetensors")
    name = next(name for name, array in arrays.items() if name != "albedo" and array.ndim)
    for change in ({"lambert": np.zeros(9, np.float32)}, {name: arrays[name][:-1]}):
        write_arrays(tmp_path / "avatar/avatar.safetensors", {**arrays, **change})
        with pytest.raises(InputError, match=r"avatar\.safetensors: expected the tensors of this version"):
            load_avatar(tmp_path / "avatar", inputs["atlas"])
    write_arrays(tmp_path / "avatar/avatar.safetensors", arrays)
    write_atlas(tmp_path / "other.safetensors", make_sheet(7))
    with pytest.raises(InputError, match=r"expected 49 texels as in .*other\.safetensors, found \d+; train again"):
        load_avatar(tmp_path / "avatar", tmp_path / "other.safetensors")
    config = json.loads((tmp_path / "avatar/config.json").read_text())
    del config["spec"]["deferred"]
    (tmp_path / "avatar/config.json").write_text(json.dumps(config))
    with pytest.raises(InputError, match="keys of this version"):
        load_avatar(tmp_path / "avatar", inputs["atlas"])


def test_no_training_image_is_told(inputs, tmp_path):
    write_image_shard(inputs["shards"] / "train/0000.arrow", [])
    with pytest.raises(InputError, match="training images"):
        stage.run(**inputs, out=tmp_path / "none")
