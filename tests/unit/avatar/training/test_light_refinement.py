"""Brightness and places of lights: found where images tell them, left alone where they do not."""

import dataclasses
import json

import numpy as np
import pytest

import pipeline.stages.train_avatar as stage
from pipeline.avatar.frames.light_gains import AS_CALIBRATED, LightGains
from pipeline.avatar.training.calibration_rounds import refinement_step
from pipeline.avatar.training.checkpoint import LoadedAvatar, load_avatar
from pipeline.avatar.training.light_refinement import Sigmas, assembled, changes_by_moving, refined_gains
from pipeline.avatar.training.picture_equations import PictureEquations, image_equations
from pipeline.avatar.training.seen_surface import seen_surface
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
    matrix, vector, _ = image_equations(parts, parts.sum(0), captured.astype(np.float32))
    found = np.linalg.solve(matrix, vector)
    # 1,080 numbers of noise 0.004, parts that differ by 0.08 (standard deviation): 0.004 / 0.08 / sqrt(1080) = 0.15 %
    # a light, four times that with what the outliers leave.
    np.testing.assert_allclose(found, wanted, atol=0.006)


def test_image_that_is_met_exactly_says_nothing():
    parts = pictures(np.random.default_rng(0))
    matrix, vector, errors = image_equations(parts, parts.sum(0), parts.sum(0))
    assert np.isfinite(matrix).all() and np.isfinite(vector).all() and errors >= 0
    assert np.abs(vector).max() < 1e-3 * max(1.0, np.abs(matrix).max())


def test_gains_stay_where_one_half_of_the_images_contradicts_the_other():
    matrix, away = np.stack([100 * np.eye(2)] * 2), np.array([5.0, -5.0])
    against = PictureEquations(matrix, np.stack([away, -away]), np.ones(2))
    gains, gained, _ = refined_gains(LIGHTS[:2], against, AS_CALIBRATED, Sigmas(gain=0.1))
    assert gained < 0 and gains is AS_CALIBRATED
    together = PictureEquations(matrix, np.stack([away, away]), np.ones(2))
    gains, gained, _ = refined_gains(LIGHTS[:2], together, AS_CALIBRATED, Sigmas(gain=0.1))
    # Of both halves: x = 10 / (200 + 1 / 0.1^2) = 1 / 30.
    np.testing.assert_allclose(gains.of(LIGHTS[:2]), [1 + 1 / 30, 1 - 1 / 30], rtol=1e-6)
    assert gained > 0


def test_lights_that_are_not_known_stay_as_they_are():
    gains = LightGains(LIGHTS[:2], np.array([1.1, 0.9], np.float32))
    np.testing.assert_array_equal(gains.of(LIGHTS[[1, 2, 0]]), np.array([0.9, 1.0, 1.1], np.float32))
    again = LightGains.from_json(json.loads(json.dumps(gains.as_json())))
    np.testing.assert_array_equal(again.of(LIGHTS), gains.of(LIGHTS))
    assert len(LightGains.from_json([]).of(LIGHTS[:0])) == 0


def lit_sheet(frame, lights=None):
    """Pictures of the sheet by one camera, in the light of each light of a frame alone, all of them white."""
    lights = frame.light_positions if lights is None else lights
    white = np.ones((1, 3), np.float32)
    one = [dataclasses.replace(frame, light_positions=p[None], light_intensities=white) for p in lights]
    return np.stack([make_image(each, np.array([0.7, 0.4, 0.2])).image for each in one])


def test_change_by_moving_a_light_is_the_difference_of_two_pictures():
    frame = make_frame(sheet := make_sheet(8), LIGHTS, np.ones((4, 3)))
    image, step, light = make_image(frame, np.array([0.7, 0.4, 0.2])), 1e-3, LIGHTS[0].astype(np.float64)
    surface = seen_surface(image, sheet.rest_vertices.astype(np.float64), sheet.faces.astype(np.int64))
    subject = image.mask > 0.5
    columns = changes_by_moving(lit_sheet(frame)[0][subject], surface, subject, image.R @ light + image.t, image.R)
    for axis, column in enumerate(columns):
        after, before = lit_sheet(frame, np.float32(light + step * np.eye(3)[[axis, axis]] * [[1], [-1]]))
        wanted = ((after - before) / (2 * step))[subject]
        inside = surface.seen[subject]
        # Differences: step^2 = 1e-6 times third derivatives, below 30 / m^3 here; float32 pictures of 0.1 over 2 mm.
        np.testing.assert_allclose(column[inside], wanted[inside], atol=5e-5)
        assert inside.sum() > 100 and np.abs(wanted).max() > 0.01


def test_light_that_stands_elsewhere_is_found():
    frame = make_frame(sheet := make_sheet(8), LIGHTS[:1], np.ones((1, 3)))
    truth = LIGHTS[:1] + np.array([[0.004, -0.006, 0.0]], np.float32)
    image = make_image(frame, np.array([0.7, 0.4, 0.2]))
    surface = seen_surface(image, sheet.rest_vertices.astype(np.float64), sheet.faces.astype(np.int64))
    subject, part = surface.seen, lit_sheet(frame)[0]
    noise = np.random.default_rng(1).normal(0, 1e-5, part.shape)
    light = image.R @ LIGHTS[0].astype(np.float64) + image.t
    rows = np.stack([part[subject], *changes_by_moving(part[subject], surface, subject, light, image.R)])
    of_frame = PictureEquations.none(4)
    for half in range(2):
        of_frame.add(half, *image_equations(rows, part[subject], (lit_sheet(frame, truth)[0] + noise)[subject]))
    places, together = assembled([LIGHTS[:1]], [of_frame], 4)
    gains, _, moved = refined_gains(places, together, AS_CALIBRATED, Sigmas(gain=0.1, light_m=0.01))
    assert moved > 0
    # Second order: (7 mm / 1.6 m)^2 of the distance, 0.03 mm; the noise of 1e-5 in pictures of 0.1 moves it by less.
    np.testing.assert_allclose(gains.moved(LIGHTS[:1]), truth, atol=5e-4)
    np.testing.assert_array_equal(gains.moved(LIGHTS[1:]), LIGHTS[1:])
    again = LightGains.from_json(json.loads(json.dumps(gains.as_json())))
    np.testing.assert_array_equal(again.moved(LIGHTS), gains.moved(LIGHTS))
    without, _, _ = refined_gains(places, together.of(slice(1)), AS_CALIBRATED, Sigmas(gain=0.1))
    assert without.offsets_m is None


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


def trained(folder, name, processes=1, **settings):
    run = SETTINGS | settings
    stage.run(**stage_arguments(folder), settings=TrainAvatar(**run), processes=processes, out=folder / name)
    return load_avatar(folder / name, folder / "atlas.safetensors")


def mean_error(folder, loaded):
    frames, images = read_frame_shards([folder / "shards/frames"]), read_image_shards([folder / "shards/train"])
    errors = [np.abs(loaded.render(frames[i.frame], i)[0].numpy() - i.image)[i.mask > 0.99].mean() for i in images]
    return float(np.mean(errors))


@pytest.mark.parametrize("settings", [{}, {"albedo_start": "grey"}, {"albedo_start": "grey", "steps": 360}])
def test_training_finds_lights_that_are_brighter_than_calibrated(miscalibrated, settings):
    """Also where the albedo has long learned, from the start or by 108 steps, to stand in for brightness."""
    loaded = trained(miscalibrated, "refined", **settings)
    as_calibrated = LoadedAvatar(loaded.avatar, loaded.atlas)
    gains = loaded.light_gains.of(LIGHTS)
    found = gains / gains.mean()  # how bright all are together is the albedo's to say
    np.testing.assert_allclose(found, TOO_BRIGHT / TOO_BRIGHT.mean(), atol=0.015)
    assert mean_error(miscalibrated, loaded) < mean_error(miscalibrated, as_calibrated)


def test_nothing_is_refined_where_settings_say_so():
    assert refinement_step(TrainAvatar(steps=100)) == 30
    assert refinement_step(TrainAvatar(steps=100, refine_lights=False, refine_cameras=True)) == 30
    assert refinement_step(TrainAvatar(steps=100, refine_lights=False)) is None


def test_stop_and_processes_change_nothing(miscalibrated):
    short = {"steps": 20, "refine_light_places": True, "refine_cameras": True}
    alone = trained(miscalibrated, "alone", **short)
    assert len(alone.light_gains.factors)
    two = trained(miscalibrated, "two", processes=2, **short)
    assert two.light_gains.as_json() == alone.light_gains.as_json()
    assert two.camera_offsets.as_json() == alone.camera_offsets.as_json()
