"""The presets are what the rule makes of the curves."""

from __future__ import annotations

import pytest
import yaml

from pipeline.base.code_digest import ROOT
from pipeline.budget.curves import FOLDER, read_curves, read_measured
from pipeline.budget.presets import DRAFT_TIMES, RULES, preset_yaml
from tests.support.results.curve_files import write_curves

COMMITTED = ROOT / FOLDER


def presets(path) -> dict[str, dict]:
    read = read_curves(path), read_measured(path.parent / "subject.yaml")
    return {name: yaml.safe_load(preset_yaml(name, *read)) for name in RULES}


def test_rule_on_curves_made_by_hand(tmp_path) -> None:
    made = presets(write_curves(tmp_path))
    assert made["draft"] == {
        "train_avatar": {"steps": 100, "supersample": 1},  # 1.0 and 0.5 dB are within ten times 0.1
        "trace_irradiance": {"samples": "full"},  # 0.2 is not within ten times 0.01
        "relight_avatar": {"environment_height": 8},
    }
    assert made["standard"] == {
        "train_avatar": {"steps": 400, "supersample": 2},
        "trace_irradiance": {"samples": "full"},
        "relight_avatar": {"environment_height": 16},
    }
    assert made["reference"] == made["standard"]


def test_where_nothing_is_good_enough_the_best_is_taken(tmp_path) -> None:
    key = ("irradiance_power", "trace_irradiance", "samples", "irradiance, RMS (truth)", 0.001)
    made = presets(write_curves(tmp_path, {key: {"1": (0.5, 3.0), "4": (0.2, 4.0), "8": (0.2, 3.5)}}))
    assert {preset["trace_irradiance"]["samples"] for preset in made.values()} == {"8"}


@pytest.mark.parametrize("preset", RULES)
def test_committed_presets_are_what_the_rule_makes_of_the_committed_curves(preset) -> None:
    curves, measured = read_curves(COMMITTED / "accuracy_cost.csv"), read_measured(COMMITTED / "subject.yaml")
    assert (ROOT / f"config/presets/{preset}.yaml").read_text() == preset_yaml(preset, curves, measured)


def test_committed_presets_follow_their_rule() -> None:
    """Checked from the table itself, without the code that chooses."""
    curves = {(curve.stage, curve.option): curve for curve in read_curves(COMMITTED / "accuracy_cost.csv")}
    loaded = {name: yaml.safe_load((ROOT / f"config/presets/{name}.yaml").read_text()) for name in RULES}
    for (stage, option), curve in curves.items():
        places = {name: curve.settings.index(text_of(loaded[name][stage][option])) for name in RULES}
        errors = {name: curve.errors[place] for name, place in places.items()}
        assert errors["reference"] == min(curve.errors), (stage, option)
        best = min(curve.errors)
        assert errors["standard"] <= max(curve.allowed, best) and errors["draft"] <= max(
            DRAFT_TIMES * curve.allowed, best
        )
        good = [(s, e) for s, e in zip(curve.seconds, curve.errors, strict=True) if e <= curve.allowed]
        # Of those that take a twentieth more than the fastest at most, the most accurate.
        as_fast = [error for second, error in good if second <= 1.05 * min(good)[0]]
        assert not good or errors["standard"] == min(as_fast), (stage, option)


def test_of_settings_that_are_about_as_fast_the_most_accurate_is_taken(tmp_path) -> None:
    key = ("irradiance_power", "trace_irradiance", "samples", "irradiance, RMS (truth)", 0.1)
    made = presets(write_curves(tmp_path, {key: {"1": (0.09, 3.0), "4": (0.05, 3.14), "8": (0.01, 3.2)}}))
    assert made["standard"]["trace_irradiance"]["samples"] == "4"


def text_of(value) -> str:
    return "all" if value is None else str(value)
