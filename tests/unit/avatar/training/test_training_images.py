"""Fewer cameras and fewer light patterns: the same ones every time, fewer a part of more, and far from each other."""

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from pipeline.avatar.training.training_images import chosen_images, spread_cameras
from pipeline.base.errors import InputError
from pipeline.config.train_avatar import TrainAvatar
from tests.support.avatars.sheet import make_frame, make_sheet


@pytest.fixture(scope="module")
def capture():
    """Eight cameras on a ring, twelve frames: every third fully lit; of the eight others, six see a pattern alone."""
    rows, angles = [], 2 * np.pi * np.arange(8) / 8
    for camera, angle in enumerate(angles):
        R = np.array([[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]])
        t = -R @ (2 * np.array([np.sin(angle), 0, np.cos(angle)]))
        for frame in range(12):
            rows.append({"camera": f"c{camera}", "frame": frame, "fully_lit": frame % 3 == 0, "R": R.ravel(), "t": t})
    frames = {}
    for frame in range(12):
        place = np.array([[0.0, 0.0, 1.0]]) if frame % 3 == 0 else np.array([[1.0, 0.0, min(frame, 10)]])
        frames[frame] = make_frame(make_sheet(8), place, np.ones((1, 3)), frame)
    return pd.DataFrame(rows), frames


def choose(capture, subject="someone", **settings):
    table, frames = capture
    return table.iloc[chosen_images(table, frames, TrainAvatar(**settings), subject)]


def test_by_default_all_images_train_in_their_order(capture):
    assert choose(capture).index.tolist() == list(range(96))


def test_fewer_cameras_are_spread_and_a_part_of_more(capture):
    chosen = {count: set(choose(capture, cameras=count).camera) for count in (1, 2, 4, 8)}
    assert chosen[1] < chosen[2] < chosen[4] < chosen[8]
    assert chosen[2] == {"c0", "c4"}  # across the ring
    assert chosen[4] == {"c0", "c2", "c4", "c6"}
    assert set(choose(capture, cameras=2).frame) == set(range(12))
    with pytest.raises(InputError, match="expected at most 8, those with training images, found 9"):
        choose(capture, cameras=9)


def test_fewer_patterns_keep_all_fully_lit_frames_and_whole_patterns(capture):
    kept = {share: set(choose(capture, light_share=share).frame) for share in (0.01, 0.3, 0.5, 0.99)}
    assert all({0, 3, 6, 9} <= frames for frames in kept.values())
    assert kept[0.01] < kept[0.3] < kept[0.5] < kept[0.99] == set(range(12))
    assert len(kept[0.01]) in (5, 6)
    for frames in kept.values():
        assert (10 in frames) == (11 in frames)  # one pattern
    assert any(set(choose(capture, f"s{n}", light_share=0.3).frame) != kept[0.3] for n in range(5))
    assert choose(capture, light_share=0.3).camera.nunique() == 8


def test_spread_cameras_are_far_apart_by_their_centres_in_an_irregular_rig_with_roll():
    """Next is always the camera farthest from those before it; R for its transpose puts centres elsewhere."""
    rng, rows = np.random.default_rng(4), []
    centers = rng.normal(size=(9, 3)) * [3, 1, 2]
    for number, center in enumerate(centers):
        R = Rotation.random(random_state=number).as_matrix()
        rows.append({"camera": f"c{number}", "frame": 0, "fully_lit": True, "R": R.ravel(), "t": -R @ center})
    expected = [0]
    while len(expected) < 5:
        nearest = [min(np.linalg.norm(center - centers[i]) for i in expected) for center in centers]
        expected.append(int(np.argmax(nearest)))
    assert spread_cameras(pd.DataFrame(rows), 5) == [f"c{number}" for number in expected]
