"""The presets are what the rule makes of the curves."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import yaml

from pipeline.base.code_digest import ROOT
from pipeline.budget.curves import FOLDER, read_curves, read_measured
from pipeline.budget.presets import DRAFT_TIMES, RULES, choose, preset_yaml
from pipeline.config.project import SECTIONS
from tests.support.results.curve_files import write_curves, write_subjects

COMMITTED = ROOT / FOLDER


def presets(path) -> dict[str, dict]:
    read = read_curves(path), read_measured(path.parent / "subjects.yaml")
    return {name: yaml.safe_load(preset_yaml(name, *read)) for name in RULES}


def test_rule_on_curves_made_by_hand(tmp_path) -> None:
    made = presets(write_curves(tmp_path))
    assert made["draft"] == {
        "train_avatar": {"steps": 100, "supersample": 1},  # 1.0 and 0.5 dB are within ten times 0.1
        "trace_irradiance": {"samples": "full"},  # 0.2 is not within ten times 0.01
        "relight_avatar": {"environment_height": 8},
    }
    assert made["standard"] == {
        "train_avatar": {"steps": 400, "supersample": 3},
        "trace_irradiance": {"samples": "full"},
        "relight_avatar": {"environment_height": 16},
    }
    # Nothing says that 400 steps are as good as the default of 2,000, or a panorama of 16 rows as one of 32.
    assert made["reference"]["train_avatar"] == {"steps": 2000, "supersample": 3}
    assert made["reference"]["trace_irradiance"] == {"samples": "full"}


def test_where_nothing_is_good_enough_the_best_is_taken(tmp_path) -> None:
    key = ("irradiance_power", "trace_irradiance", "samples", "irradiance, RMS (truth)", 0.001)
    made = presets(
        write_curves(tmp_path, {key: {"1": (0.5, 3.0), "4": (0.2, 4.0), "8": (0.2, 3.5), "full": (0.3, 6.0)}})
    )
    assert {preset["trace_irradiance"]["samples"] for preset in made.values()} == {"8"}


@pytest.mark.parametrize("preset", RULES)
def test_committed_presets_are_what_the_rule_makes_of_the_committed_curves(preset) -> None:
    curves, measured = read_curves(COMMITTED / "accuracy_cost.csv"), read_measured(COMMITTED / "subjects.yaml")
    assert (ROOT / f"config/presets/{preset}.yaml").read_text() == preset_yaml(preset, curves, measured)


def test_committed_presets_follow_their_rule() -> None:
    """Checked from the table itself, without the code that chooses."""
    table = pd.read_csv(COMMITTED / "accuracy_cost.csv", dtype={"setting": str})
    loaded = {name: yaml.safe_load((ROOT / f"config/presets/{name}.yaml").read_text()) for name in RULES}
    for (stage, option, _), rows in table.groupby(["stage", "option", "subject"]):
        rows = rows[(rows.metric == rows.metric.iloc[0]) & rows.error.notna()].set_index("setting")
        chosen = {name: text_of(preset[stage][option]) for name, preset in loaded.items()}
        default = text_of(SECTIONS[stage]().model_dump(mode="json")[option])
        if default in rows.index:
            allowed = rows.error[default] + np.hypot(*rows.standard_error.fillna(0)[[chosen["reference"], default]])
            assert rows.error[chosen["reference"]] <= allowed, (stage, option)
        best = rows.error.min()
        assert rows.error[chosen["standard"]] <= max(rows.allowed.iloc[0], best), (stage, option)
        assert rows.error[chosen["draft"]] <= max(DRAFT_TIMES * rows.allowed.iloc[0], best), (stage, option)


class TestReference:
    KEY = ("supersampling", "train_avatar", "supersample", "PSNR lost, dB", 0.1)

    def chosen(self, folder, **subjects) -> int:
        path = write_subjects(folder, {name: {self.KEY: own} for name, own in subjects.items()})
        (curve,) = read_curves(path)
        return choose("reference", curve)

    def test_it_is_as_good_as_the_default_on_every_subject(self, tmp_path) -> None:
        """Two is best on one subject, by far, and worse than the default of three on the other."""
        one = {"1": (1.0, 2.5), "2": (-0.5, 3.0), "3": (0.0, 4.0)}
        other = {"1": (1.0, 2.5), "2": (0.2, 3.0), "3": (0.0, 4.0)}
        assert self.chosen(tmp_path / "a", one=one) == 2
        assert self.chosen(tmp_path / "b", one=one, other=other) == 3

    def test_what_the_standard_error_covers_is_as_good(self, tmp_path) -> None:
        """The errors' own are 0.02: 0.028 of their difference."""
        for lost, expected in ((0.03, 3), (0.027, 2)):
            other = {"2": (lost, 3.0), "3": (0.0, 4.0)}
            one = {"2": (-0.5, 3.0), "3": (0.05, 4.0)}
            assert self.chosen(tmp_path / str(lost), one=one, other=other) == expected


def test_of_settings_that_are_about_as_fast_the_most_accurate_is_taken(tmp_path) -> None:
    key = ("irradiance_power", "trace_irradiance", "samples", "irradiance, RMS (truth)", 0.1)
    made = presets(write_curves(tmp_path, {key: {"1": (0.09, 3.0), "4": (0.05, 3.14), "8": (0.01, 3.2)}}))
    assert made["standard"]["trace_irradiance"]["samples"] == "4"


def text_of(value) -> str:
    return "all" if value is None else str(value)
