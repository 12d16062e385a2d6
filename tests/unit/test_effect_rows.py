"""The table of effects as it grows: what was measured is kept, what other code measured is not."""

from __future__ import annotations

import pandas as pd
import pytest

from benchmarks.effect_rows import EffectRows


def row(scene, avatar, psnr_db, seconds, draw="report"):
    return {
        "scene": scene, "avatar": avatar, "psnr_db": psnr_db, "cpu_seconds": seconds, "draw": draw, "steps": 300,
    }  # fmt: skip


@pytest.fixture
def path(tmp_path):
    """A table of one scene."""
    path = tmp_path / "effects.csv"
    EffectRows(path, 300).add([row("glossy", "everything", 30.0, 40.0), row("glossy", "auto", 32.5, 10.0)])
    return path


def test_row_is_held_against_everything_on_of_its_own_scene_and_draw(path):
    rows = EffectRows(path, 300)
    rows.add([row("glossy", "everything", 20.0, 80.0, "report_2")])
    [added] = rows.add([row("glossy", "auto", 21.0, 20.0, "report_2")])  # of a later run than what it is held against
    assert (added["psnr_lost_db"], added["cpu_ratio"]) == (-1.0, 0.25)
    table = pd.read_csv(path).set_index(["draw", "avatar"])
    assert table.psnr_lost_db["report", "auto"] == -2.5 and table.cpu_ratio["report", "auto"] == 0.25


def test_run_that_was_ended_goes_on_with_what_is_missing(path):
    rows = EffectRows(path, 300)
    assert rows.missing("report", "glossy", ["everything", "auto", "not_shadow"]) == ["not_shadow"]
    assert rows.missing("report_2", "glossy", ["auto"]) == ["auto"]
    assert rows.missing("report", "diffuse", ["auto"]) == ["auto"]


@pytest.mark.parametrize(("column", "value"), [("code", "0123456789abcdef"), ("steps", 200)])
def test_row_of_other_code_or_steps_is_measured_anew(path, column, value):
    pd.read_csv(path).assign(**{column: value}).to_csv(path, index=False)
    rows = EffectRows(path, 300)
    assert rows.missing("report", "glossy", ["auto"]) == ["auto"]
    rows.add([row("glossy", "everything", 30.0, 40.0)])
    assert len(pd.read_csv(path)) == 1


def test_scenes_stand_in_their_order_whichever_comes_first(path):
    EffectRows(path, 300).add([row("diffuse", "everything", 33.0, 30.0)])
    assert list(pd.read_csv(path).scene) == ["diffuse", "glossy", "glossy"]
