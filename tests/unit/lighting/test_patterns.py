"""Bookkeeping of patterns on a small stage whose every number is known."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from pipeline.geometry.cameras import Camera
from pipeline.lighting.patterns import (
    book_frames,
    book_patterns_rgb,
    observed_brightness,
    predicted_brightness,
    shift_patterns,
    subject_center,
    suspicious_frames,
)

LIGHTS = pd.DataFrame({"light": ["A", "B"], "x": [2.0, 0.0], "y": [0.0, 1.0], "z": [0.0, 3.0]})
FRAMES = pd.DataFrame({"frame": [3, 1, 2, 0], "timestamp_s": [0.3, 0.1, 0.2, 0.0], "segment": ["b", "a", "a", "a"]})
PATTERNS = pd.DataFrame(
    {"frame": [0, 0, 1, 2, 2], "light": ["B", "A", "A", "B", "A"], "intensity": [2.0, 4.0, 8.0, 2.0, 0.0]}
)
IMAGES = pd.DataFrame(
    {
        "frame": [0, 0, 1, 2, 3],
        "camera": ["c", "d", "c", "c", "c"],
        "test_camera": [False, True, False, False, False],
        "test_frame": [False, False, True, False, True],
        "test_segment": [False, False, False, False, True],
    }
)


def test_frames_are_booked_in_order():
    booked = book_frames(FRAMES, IMAGES, PATTERNS, ["A", "B"])
    assert booked.frame.tolist() == [0, 1, 2, 3]
    assert booked.lights_on.tolist() == [2, 1, 1, 0]  # a light of intensity 0 is off
    assert booked.fully_lit.tolist() == [True, False, False, False]
    assert booked.split.tolist() == ["train", "test_frames", "train", "test_segments"]
    table = book_patterns_rgb(PATTERNS, booked)
    assert table[["frame", "light"]].to_numpy().tolist() == [[0, "A"], [0, "B"], [1, "A"], [2, "B"]]
    assert (table.intensity_r == [4, 2, 8, 2]).all()
    assert (table.intensity_b == table.intensity_r).all()
    assert table.fully_lit.tolist() == [True, True, False, False]


def test_predicted_brightness_falls_with_the_square_of_the_distance():
    predicted = predicted_brightness(PATTERNS, LIGHTS, pd.Series([0, 1, 2, 3]), np.array([0.0, 1.0, 0.0]))
    # |A - centre|^2 = 5, |B - centre|^2 = 9
    assert predicted.tolist() == pytest.approx([4 / 5 + 2 / 9, 8 / 5, 2 / 9, 0.0])


def test_observed_brightness_ignores_gain_and_missing_images():
    truth = {0: 1.0, 1: 3.0, 2: 2.0}
    rows = [(c, f, g * b) for c, g in (("c", 1.0), ("d", 7.0)) for f, b in truth.items()]
    means = pd.DataFrame(rows, columns=["camera", "frame", "brightness"])
    assert observed_brightness(means).tolist() == pytest.approx([0.5, 1.5, 1.0])
    assert observed_brightness(means[:-1]).index.tolist() == [0, 1, 2]


def test_shifted_patterns_drop_frames_without_a_log():
    moved, frames = shift_patterns(PATTERNS, FRAMES, 1)  # images of frame f show what was logged for f + 1
    assert sorted(frames.frame) == [0, 1, 2]
    assert moved.groupby("frame").size().to_dict() == {0: 1, 1: 2}
    moved, frames = shift_patterns(PATTERNS, FRAMES, -2)
    assert sorted(frames.frame) == [2, 3]
    assert sorted(moved.frame.unique()) == [2, 3]
    same, frames = shift_patterns(PATTERNS, FRAMES, 0)
    pd.testing.assert_frame_equal(same, PATTERNS)


def test_subject_center_is_where_the_rays_meet():
    target = np.array([0.2, 1.1, -0.3])
    cameras, pixels = {}, {}
    for i, angle in enumerate((0.0, 1.0, 2.5)):
        R = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        K = np.array([[200.0, 0, 64], [0, 200, 48], [0, 0, 1]])
        camera = Camera(R, np.array([0.1, -0.9, 4.0]), K, np.array([-0.1, 0.02, 0, 0, 0]), 128, 96)
        cameras[str(i)], pixels[str(i)] = camera, camera.project(target)[0]
    np.testing.assert_allclose(subject_center(cameras, pixels), target, atol=1e-6)  # undistortion iterates to 1e-9
    assert np.isfinite(subject_center(cameras, {"0": pixels["0"]})).all()


def booked_table(seed: int = 0, count: int = 48) -> pd.DataFrame:
    rng = np.random.default_rng(seed)
    fully_lit = np.arange(count) % 3 == 0
    predicted = np.where(fully_lit, 1.0, rng.uniform(0.5, 1.3, count))
    observed = predicted * np.where(fully_lit, 1.0, 0.7) * (1 + 0.08 * rng.normal(size=count))
    return pd.DataFrame({"fully_lit": fully_lit, "predicted": predicted, "observed": observed})


def test_a_planted_wrong_frame_is_the_only_suspicious_one():
    for seed in range(20):
        table = booked_table(seed)
        assert not suspicious_frames(table, 6.0).any()
        for frame, factor in ((9, 3.0), (10, 0.2), (11, 0.0)):
            wrong = table.copy()
            wrong.loc[frame, "observed"] *= factor
            assert suspicious_frames(wrong, 6.0)[lambda s: s].index.tolist() == [frame]


def test_dark_frames():
    table = booked_table()
    table.loc[5, ["predicted", "observed"]] = 0.0  # dark as logged
    table.loc[7, "predicted"] = 0.0  # lit, though logged as dark
    table.loc[8, "observed"] = np.nan  # no image
    assert suspicious_frames(table, 6.0)[lambda s: s].index.tolist() == [7]
    table["observed"] = np.nan
    assert not suspicious_frames(table, 6.0).any()


def test_a_perfectly_steady_stage_is_not_suspicious():
    table = booked_table()
    table["observed"] = table.predicted * (1 + 1e-6 * np.arange(len(table)))
    assert not suspicious_frames(table, 6.0).any()
