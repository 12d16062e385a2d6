"""A survey of lights that is a known similarity away from the lights that were measured."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.calibration.lights.survey_verdict import WITHIN, survey_verdict
from pipeline.config.calibrate_lights import CalibrateLights
from pipeline.geometry.rigid_alignment import align_rigid


def judged(noise_m=0.01, scale=1.0, turn_deg=0.0, shift_m=0.0, in_stage=True):
    rng = np.random.default_rng(2)
    lights = rng.normal(size=(20, 3))
    lights *= 2.4 / np.linalg.norm(lights, axis=1, keepdims=True)
    turned = Rotation.from_euler("Y", turn_deg, degrees=True).apply(scale * lights)
    surveyed = turned + np.array([shift_m, 0, 0]) + rng.normal(0, noise_m, lights.shape)
    measured = lights + rng.normal(0, 0.001, lights.shape)
    return survey_verdict(measured, surveyed, align_rigid(measured, surveyed), in_stage, CalibrateLights())


@pytest.mark.parametrize("in_stage", [False, True])
def test_a_survey_good_to_a_centimetre_is_good(in_stage):
    assert judged(in_stage=in_stage).grade == "good"


def test_cameras_that_the_survey_places_may_be_anywhere():
    assert judged(turn_deg=70, shift_m=3.0, in_stage=False).grade == "good"


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"scale": 1.02}, "times as large"),
        ({"turn_deg": 1.5}, "turned by 1.4"),
        ({"shift_m": 0.04}, "mm beside the cameras' frame"),
    ],
)
def test_a_similarity_away_is_weak_and_says_how(change, says):
    verdict = judged(**change)
    assert verdict.grade == "weak" and says in verdict.reason


def test_a_survey_in_which_a_light_elsewhere_could_not_be_told_is_weak():
    verdict = judged(noise_m=0.08)
    assert verdict.grade == "weak" and "so rough" in verdict.reason


def test_999_of_1000_points_are_within_the_radius():
    lengths = np.linalg.norm(np.random.default_rng(0).normal(size=(400_000, 3)), axis=1)
    assert (lengths > WITHIN).mean() == pytest.approx(1e-3, rel=0.2)
