"""Eyes that are open or closed together."""

from __future__ import annotations

import numpy as np

from pipeline.eyes.closed_lids import SURE_ALONE, open_together
from pipeline.eyes.gaze_estimate import GazeEstimate

AHEAD = np.array([0.0, 0.0, 1.0])


def eye(status, explained):
    direction = AHEAD if status == "estimated" else np.full(3, np.nan)
    return GazeEstimate(status, direction, 0.5, explained, 3, 200)


def statuses(left, right):
    found = open_together({"left": left, "right": right})
    return [estimate.status for estimate in found["left"]], [estimate.status for estimate in found["right"]]


def test_an_eye_that_little_explains_is_closed_where_the_other_is():
    weak, sure = eye("estimated", SURE_ALONE - 0.01), eye("estimated", SURE_ALONE)
    none, hidden = eye("unclear", 0.1), eye("hidden", 0.0)
    left, right = statuses([weak, sure, weak, weak], [none, none, weak, hidden])
    assert left == ["unclear", "estimated", "estimated", "estimated"]
    assert right == ["unclear", "unclear", "estimated", "hidden"]


def test_what_is_unclear_has_no_gaze_and_keeps_what_was_measured():
    found = open_together({"left": [eye("estimated", 0.45)], "right": [eye("unclear", 0.2)]})["left"][0]
    assert np.isnan(found.direction).all() and np.isnan(found.sigma_deg)
    assert (found.explained, found.views, found.pixels) == (0.45, 3, 200)


def test_a_single_eye_has_no_other():
    assert open_together({"left": [eye("estimated", 0.45)]})["left"][0].status == "estimated"
