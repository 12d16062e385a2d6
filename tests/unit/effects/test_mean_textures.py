"""What texels get that cameras do not see, and frames between fully lit ones."""

import numpy as np

from pipeline.effects.mean_textures import SeenColors, between_lit_frames, fill_unseen, joined

ROUNDING = 1e-12
"""A few roundings of numbers of size one."""

PLACES = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3.6, 0, 0]])


def seen(grey, weight):
    weight = np.array(weight, np.float64)
    return SeenColors(np.array(grey, np.float64)[:, None] * (weight > 0)[:, None] * np.ones(3), weight)


def test_frames_join_by_their_weights():
    both = joined([seen([0.2, 0.4, 0, 0], [1, 2, 0, 0]), seen([0.8, 0.4, 0.6, 0], [3, 1, 0.5, 0])])
    np.testing.assert_allclose(both.mean[:, 0], [0.65, 0.4, 0.6, 0], atol=ROUNDING)
    np.testing.assert_allclose(both.weight, [4, 3, 0.5, 0])


def test_unseen_texels_take_their_own_colour_of_other_frames_then_a_neighbours():
    filled = fill_unseen([seen([0.2, 0.4, 0, 0], [1, 2, 0, 0]), seen([0.8, 0, 0.6, 0], [3, 0, 0.5, 0])], PLACES)
    np.testing.assert_allclose(filled[0][:, 1], [0.2, 0.4, 0.6, 0.6], atol=ROUNDING)
    np.testing.assert_allclose(filled[1][:, 2], [0.8, 0.4, 0.6, 0.6], atol=ROUNDING)


def test_nothing_seen_at_all_is_black():
    filled = fill_unseen([seen([0, 0, 0, 0], [0, 0, 0, 0])] * 2, PLACES)
    np.testing.assert_array_equal(filled, np.zeros((2, 4, 3)))


def test_textures_between_lit_frames_of_a_take():
    lit = np.array([False, True, False, False, True, False, True, False])
    takes = np.array([0, 0, 0, 0, 0, 1, 1, 1])
    textures = np.array([0.0, 3.0, 9.0])[:, None, None] * np.ones((1, 2, 3))
    found = between_lit_frames(textures, lit, takes)
    np.testing.assert_allclose(found[:, 1, 1], [0, 0, 1, 2, 3, 9, 9, 9], atol=ROUNDING)
