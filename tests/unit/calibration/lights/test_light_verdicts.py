"""What is said of lights, one number at a time."""

from __future__ import annotations

import pandas as pd
import pytest

from pipeline.calibration.lights.light_verdicts import light_verdicts, why_not_measured
from pipeline.config.calibrate_lights import CalibrateLights

SOUND = {
    "light": "L0", "images": 8, "highlights": 8, "agreeing": 8, "rival": 0, "sigma_m": 0.004, "away_m": 0.02,
    "looks_like": "", "status": "measured", "no_intensity": "", "no_color": "",
}  # fmt: skip


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({}, ""), ({"images": 0}, "no image of it"), ({"highlights": 0}, "is the LED dead?"),
        ({"highlights": 2}, "in only 2 of 8 images"), ({"rival": 3}, "two lights shine"),
        ({"agreeing": 2}, "only 2 of 8 highlights agree"), ({"sigma_m": 0.04}, "uncertain by 40 mm per axis"),
        ({"sigma_m": float("nan")}, "uncertain by nan mm"),
    ],
)  # fmt: skip
def test_light_is_not_measured_for_a_reason(change, said):
    why = why_not_measured(pd.Series(SOUND | change), CalibrateLights())
    assert said in why and bool(said) == bool(why)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({}, ""), ({"sigma_m": 0.02}, "uncertain: add"), ({"agreeing": 3}, "only 3 of its highlights agree"),
        ({"away_m": 0.5}, "was it moved?"), ({"away_m": 0.5, "looks_like": "L7"}, "where the survey has L7"),
    ],
)  # fmt: skip
def test_measured_light_is_weak_for_a_reason(change, said):
    (verdict,) = light_verdicts(pd.DataFrame([SOUND | change]), CalibrateLights())
    assert verdict.grade == ("weak" if said else "good") and said in verdict.reason
