"""Surveys and transfer functions that are wrong in a known way, under the brightness of a traced figure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.sync.led_faults import Patterns
from pipeline.sync.log_alternatives import Rig, moved_lights, survey_verdict, transfer_verdict
from pipeline.sync.subject_proxy import Ellipsoid
from tests.support.rigs.light_stage import always_fully_lit, brightness_model, build_stage, photograph, random_groups

STAND_IN = Ellipsoid(np.array([0.0, -0.05, 0.0]), np.diag([0.3, 0.85, 0.25]))
FRAMES = 30


@pytest.fixture(scope="module")
def stage():
    return build_stage(3, frames=FRAMES, cameras=6, lights=20)


def recorded(stage, interleave=random_groups):
    rng = np.random.default_rng(1)
    log = interleave(stage, rng)
    return brightness_model(stage, log, photograph(stage, log, rng)), Patterns(log.mean(2), np.ones(FRAMES, bool))


def surveyed(stage, lights):
    model, patterns = recorded(stage)
    rig = Rig(lights, stage.cameras, STAND_IN)
    return survey_verdict(moved_lights(model, rig, lights), patterns, rig, 5.0)


def test_a_true_survey_is_good(stage):
    assert surveyed(stage, stage.lights).grade == "good"


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (np.diag([-1.0, 1, 1]), "(-x, y, z)"),
        (np.array([[1.0, 0, 0], [0, 0, 1], [0, 1, 0]]), "(x, z, y)"),
    ],
)
def test_a_survey_in_other_axes_is_failed_and_the_way_back_named(stage, change, says):
    verdict = surveyed(stage, stage.lights @ change.T)
    assert verdict.grade == "failed" and says in verdict.reason


def test_a_survey_with_another_origin_is_failed(stage):
    verdict = surveyed(stage, stage.lights + np.array([0, 0, 1.1]))
    assert verdict.grade == "failed" and "along z" in verdict.reason and "by -" in verdict.reason


@pytest.mark.parametrize(("one", "other"), [(2, 9), (0, 13)])
def test_two_lights_with_each_others_names_are_named(stage, one, other):
    """They are 4.2 and 3.3 m apart."""
    lights = stage.lights.copy()
    lights[[one, other]] = lights[[other, one]]
    verdict = surveyed(stage, lights)
    assert verdict.grade == "failed"
    assert f"lights that are exchanged, L{one:03d} with L{other:03d}, better by" in verdict.reason


@pytest.mark.parametrize(
    ("factor", "grade"), [(3.281, "weak"), (39.37, "failed"), (1000.0, "failed"), (1e-3, "failed")]
)
def test_a_survey_in_another_unit_than_the_cameras(stage, factor, grade):
    assert surveyed(stage, factor * stage.lights).grade == grade


@pytest.mark.parametrize(
    ("power", "grade", "says"), [(1.0, "good", ""), (1 / 2.2, "failed", "srgb, and read as linear"),
                                 (2.2, "failed", "linear, and read as srgb")]
)  # fmt: skip
def test_a_transfer_function_shows_in_how_brightness_grows_with_light(stage, power, grade, says):
    model, patterns = recorded(stage)
    verdict = transfer_verdict(replace(model, seen=np.maximum(model.seen, 1e-6) ** power), patterns, 5.0)
    assert verdict.grade == grade and says in verdict.reason


def test_light_that_never_changes_tells_no_transfer_function(stage):
    verdict = transfer_verdict(*recorded(stage, always_fully_lit), 5.0)
    assert verdict.grade == "weak" and "not told" in verdict.reason
