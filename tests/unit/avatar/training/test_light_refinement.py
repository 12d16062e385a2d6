"""Brightness of lights: found where images tell it, left alone where they do not."""

import dataclasses
import json

import numpy as np
import pytest

import pipeline.stages.train_avatar as stage
from pipeline.avatar.frames.light_gains import AS_CALIBRATED, LightGains
from pipeline.avatar.training.checkpoint import load_avatar
from pipeline.avatar.training.light_refinement import LightEquations, frame_equations, refined_gains
from pipeline.capture.shards import read_frame_shards, read_image_shards, write_frame_shard
from pipeline.config.train_avatar import TrainAvatar
from tests.support.avatars.sheet import make_frame, make_image, make_sheet
from tests.support.avatars.sheet_subject import stage_arguments, write_subject

LIGHTS = np.array([[0.5, 0.3, 1.5], [-0.6, 0.0, 1.2], [0.0, -0.7, 1.0], [0.1, 0.8, 1.3]], np.float32)

TOO_BRIGHT = np.array([1.08, 0.94, 1.0, 0.97])
"""What lights really send over what their calibration says."""

SETTINGS = {"shading": "microfacet", "normals": "mesh", "indirect": "none", "steps": 120, "checkpoint_every": 1000}
"""Normals that are learned could stand in for brightness: the bas-relief ambiguity of photometric stereo."""

CHANNELS_AND_PIXELS = (400, 3)


def pictures(rng):
    return rng.uniform(0.02, 0.3, (3, *CHANNELS_AND_PIXELS)).astype(np.float32)


def test_factors_are_found_from_their_sum_with_noise_and_pixels_that_are_something_else(rng=np.random.default_rng(3)):
    parts, wanted = pictures(rng), np.array([0.06, -0.04, 0.01])
    captured = ((1 + wanted)[:, None, None] * parts).sum(0) + rng.normal(0, 0.004, CHANNELS_AND_PIXELS)
    captured[:20] = 0.9  # a fiftieth of the pixels is another thing
    captured[20:40] = 1.0  # and some are cut off
    matrix, vector = frame_equations(parts, captured.astype(np.float32))
    found = np.linalg.solve(matrix, vector)
    # 1,080 numbers of noise 0.004, parts that differ by 0.08 (standard deviation): 0.004 / 0.08 / sqrt(1080) = 0.15 %
    # a light, four times that with what the outliers leave.
    np.testing.assert_allclose(found, wanted, atol=0.006)


def test_image_that_is_met_exactly_says_nothing():
    parts = pictures(np.random.default_rng(0))
    matrix, vector = frame_equations(parts, parts.sum(0))
    assert np.isfinite(matrix).all() and np.isfinite(vector).all()
    assert np.abs(vector).max() < 1e-3 * max(1.0, np.abs(matrix).max())


def test_gains_stay_where_one_half_of_the_images_contradicts_the_other():
    matrix, away = np.stack([100 * np.eye(2)] * 2), np.array([5.0, -5.0])
    against = LightEquations(matrix, np.stack([away, -away]))
    gains, gained = refined_gains(LIGHTS[:2], against, AS_CALIBRATED, 0.1)
    assert gained < 0 and gains is AS_CALIBRATED
    together = LightEquations(matrix, np.stack([away, away]))
    gains, gained = refined_gains(LIGHTS[:2], together, AS_CALIBRATED, 0.1)
    # Of both halves: x = 10 / (200 + 1 / 0.1^2) = 1 / 30.
    np.testing.assert_allclose(gains.of(LIGHTS[:2]), [1 + 1 / 30, 1 - 1 / 30], rtol=1e-6)
    assert gained > 0


def test_lights_that_are_not_known_stay_as_they_are():
    gains = LightGains(LIGHTS[:2], np.array([1.1, 0.9], np.float32))
    np.testing.assert_array_equal(gains.of(LIGHTS[[1, 2, 0]]), np.array([0.9, 1.0, 1.1], np.float32))
    again = LightGains.from_json(json.loads(json.dumps(gains.as_json())))
    np.testing.assert_array_equal(again.of(LIGHTS), gains.of(LIGHTS))
    assert len(LightGains.from_json([]).of(LIGHTS[:0])) == 0


@pytest.fixture(scope="module")
def miscalibrated(tmp_path_factory):
    """A sheet under pairs of lights, photographed in their true light, with lights as bright as a calibration says."""
    folder, sheet = tmp_path_factory.mktemp("sheet"), make_sheet(8)
    pairs = [[a, b] for a in range(len(LIGHTS)) for b in range(a)]
    says = [make_frame(sheet, LIGHTS[pair], np.full((2, 3), 1.5), i) for i, pair in enumerate(pairs)]
    says = [dataclasses.replace(frame, fully_lit=False) for frame in says]
    is_so = [
        dataclasses.replace(
            frame, light_intensities=frame.light_intensities * TOO_BRIGHT[pair, None].astype(np.float32)
        )
        for frame, pair in zip(says, pairs, strict=True)
    ]
    write_subject(folder, [make_image(f, np.array([0.7, 0.4, 0.2]), s) for f in is_so for s in (-0.2, 0.0, 0.1, 0.2)])
    write_frame_shard(folder / "shards/frames/0000.arrow", says)
    return folder


def trained(folder, name, **settings):
    arguments = SETTINGS | settings
    stage.run(**stage_arguments(folder), settings=TrainAvatar(**arguments), out=folder / name)
    loaded = load_avatar(folder / name, folder / "atlas.safetensors")
    frames, images = read_frame_shards([folder / "shards/frames"]), read_image_shards([folder / "shards/train"])
    errors = [np.abs(loaded.render(frames[i.frame], i)[0].numpy() - i.image)[i.mask > 0.99].mean() for i in images]
    return loaded.light_gains, float(np.mean(errors))


def test_training_finds_lights_that_are_brighter_than_calibrated(miscalibrated):
    gains, error = trained(miscalibrated, "refined")
    none, unrefined = trained(miscalibrated, "as_calibrated", refine_lights=False)
    found = gains.of(LIGHTS) / gains.of(LIGHTS).mean()  # how bright all are together is the albedo's to say
    np.testing.assert_allclose(found, TOO_BRIGHT / TOO_BRIGHT.mean(), atol=0.015)
    assert len(none.factors) == 0
    assert error < unrefined


def test_stop_and_processes_change_nothing(miscalibrated):
    alone, _ = trained(miscalibrated, "alone", steps=20)
    assert len(alone.factors)
    stage.run(
        **stage_arguments(miscalibrated), processes=2, out=miscalibrated / "two",
        settings=TrainAvatar(**SETTINGS | {"steps": 20}),
    )  # fmt: skip
    two = load_avatar(miscalibrated / "two", miscalibrated / "atlas.safetensors").light_gains
    np.testing.assert_array_equal(two.factors, alone.factors)
