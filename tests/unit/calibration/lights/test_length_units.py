"""One of three lengths in another unit: which, and by how much, whether it is too large or too small."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from pipeline.calibration.lights.length_units import size_by_lights, unit_complaint
from pipeline.geometry.cameras import Camera

TOLERANCE = 0.05

LENGTHS = {
    "x, y, z": lambda factor: (1.0, factor),
    "calibration.lights.radius_m": lambda factor: (factor, 1.0),
    "calibration.cameras.square_m": lambda factor: (factor, 1 / factor),
}
"""By key of the length that is wrong: ratio of the ball in the rig to what is said, and of the survey to the rig."""


@pytest.mark.parametrize("key", LENGTHS)
@pytest.mark.parametrize(
    ("factor", "unit"),
    [
        (1000.0, "millimetres for metres"), (0.001, "metres for millimetres"), (100.0, "centimetres for metres"),
        (39.37, "inches for metres"), (1 / 3.281, "metres for feet"), (1.06, ""), (1 / 1.06, ""),
    ],
)  # fmt: skip
def test_odd_length_is_named_whether_too_large_or_too_small(key, factor, unit):
    _, named, _, found, _ = unit_complaint(*LENGTHS[key](factor), TOLERANCE)
    assert named == key
    assert (f"({unit}?)" in found) if unit else "?)" not in found


@pytest.mark.parametrize("factor", [1.0, 1.04, 1 / 1.04])
def test_lengths_that_agree_raise_no_complaint(factor):
    assert all(unit_complaint(*lengths(factor), TOLERANCE) is None for lengths in LENGTHS.values())


def test_two_odd_lengths_are_not_blamed_on_one():
    assert unit_complaint(100.0, 3.0, TOLERANCE)[1] == "calibration"


@pytest.mark.parametrize(("noise_m", "factor"), [(0.003, 0.98), (0.5, 1.0)], ids=["good survey", "rough survey"])
def test_rig_without_boards_is_as_large_as_a_good_survey_says(noise_m, factor):
    """Forty lights on a dome of 2 m, of which the ball made 2 % too much; a rough survey changes nothing."""
    random = np.random.default_rng(0)
    survey = pd.DataFrame(random.normal(size=(40, 3)), columns=list("xyz"))
    survey *= 2 / np.linalg.norm(survey, axis=1)[:, None]
    facts = survey / 0.98 + [0.1, 0.2, 0.3]
    survey += random.normal(0, noise_m, survey.shape)
    names = [f"L{k}" for k in range(40)]
    facts = facts.assign(why="", sigma_m=0.01, cov_xx=1e-4).set_index(pd.Index(names, name="light"))
    camera = Camera(np.eye(3), np.array([0.0, 0, 3]), np.eye(3), np.zeros(5), 10, 10)
    larger, cameras = size_by_lights(facts, {"c": camera}, survey.assign(light=names))
    # 3 mm over 2 m and 40 lights.
    assert cameras["c"].t[2] == pytest.approx(3 * factor, rel=1e-3)
    assert larger.sigma_m.iloc[0] == pytest.approx(0.01 * factor, rel=1e-3)
    assert larger.cov_xx.iloc[0] == pytest.approx(1e-4 * factor**2, rel=2e-3)
    assert larger.x.iloc[0] == pytest.approx(facts.x.iloc[0] * factor, rel=1e-3)
