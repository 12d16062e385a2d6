"""Gaze beside eyes that were turned by known angles, right and written wrongly."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.eyes.eye_fit import FittedEye
from pipeline.eyes.eye_shape import usual_shape
from pipeline.eyes.eye_verdicts import eye_verdict, gaze_verdict

FRAMES = list(range(100, 140))


def looks(noise: float, turn: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Tracked axes and gaze: to the side by 8 degrees, up by 5 (standard deviations); noise in degrees."""
    rng = np.random.default_rng(4)
    angles = rng.normal(0, [8.0, 5.0], (len(FRAMES), 2))
    tracked = turn * angles + rng.normal(0, noise, angles.shape)
    return tuple(Rotation.from_euler("YX", a, degrees=True).apply([0, 0, 1.0]) for a in (tracked, angles))


@pytest.mark.parametrize("noise", [0.0, 0.5, 2.0])
def test_gaze_that_the_eyes_follow_is_good(noise):
    assert gaze_verdict("left", FRAMES, *looks(noise)).grade == "good"


@pytest.mark.parametrize(
    ("signs", "says"),
    [([-1, 1, 1], "left and right"), ([1, -1, 1], "up and down"), ([-1, -1, 1], "turned the other way")],
)
def test_gaze_with_a_sign_turned_is_failed_and_says_which(signs, says):
    tracked, gaze = looks(1.0)
    verdict = gaze_verdict("left", FRAMES, tracked, gaze * signs)
    assert verdict.grade == "failed" and says in verdict.reason


def test_eyes_that_stand_still_are_weak():
    verdict = gaze_verdict("left", FRAMES, *looks(1.0, turn=0.0))
    assert verdict.grade == "weak" and "did not turn" in verdict.reason


def test_frames_that_look_elsewhere_are_named():
    tracked, gaze = looks(0.5)
    gaze[7] = Rotation.from_euler("Y", 12, degrees=True).apply(gaze[7])
    verdict = gaze_verdict("left", FRAMES, tracked, gaze)
    assert verdict.grade == "weak" and "in frames 107:" in verdict.reason


def test_an_offset_beyond_that_of_the_visual_axis_is_weak():
    tracked, gaze = looks(0.5)
    verdict = gaze_verdict("left", FRAMES, tracked, Rotation.from_euler("Y", 8, degrees=True).apply(gaze))
    assert verdict.grade == "weak" and "does not follow" in verdict.reason


@pytest.mark.parametrize(("axis", "rms", "grade"), [(1, 1e-5, "good"), (1, 5e-4, "weak"), (-1, 1e-5, "failed")])
def test_an_eye_is_judged_by_its_fit_and_by_where_the_head_is(axis, rms, grade):
    """The head: points behind the eye."""
    rest = np.concatenate([np.zeros((3, 3)), [[0, 0, -0.05], [0.02, 0, -0.06], [0, 0.03, -0.02]]])
    eye = FittedEye((0.0, 0.0, 0.0), (0.0, 0.0, float(axis)), usual_shape(0.012), "usual", {}, rms, 1.0, (0, 1, 2))
    assert eye_verdict("left", eye, rest).grade == grade
