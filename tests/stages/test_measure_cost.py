"""The stage with tiny programs in place of stages, and once with a real one."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pandas as pd
import pytest

import pipeline.stages.measure_cost
import pipeline.stages.trace_irradiance
from pipeline.base.errors import InputError
from pipeline.config.measure_cost import COSTED_STAGES, MeasureCost
from pipeline.config.project import SubjectSettings
from pipeline.config.stage_settings import changed_settings, read_stage_settings
from pipeline.config.trace_irradiance import TraceIrradiance
from pipeline.dials.dial import CostedStage, Dial, Metric
from pipeline.dials.subject import Subject
from pipeline.stages.measure_cost import run
from tests.support.captures.posed import write_posed_capture

PROGRAM = """
import json, pathlib, sys
out, value, history = pathlib.Path(sys.argv[1]), float(sys.argv[2]), pathlib.Path(sys.argv[3])
with history.open("a") as file: file.write(sys.argv[2] + " ")
if value == 3: sys.exit("error: three is refused")
if value == 4: raise RuntimeError("four breaks")
assert not out.exists(), "left over from another run"
out.mkdir(parents=True)
(out / "value.json").write_text(json.dumps(10 / value))
"""


@dataclass(frozen=True)
class TinyStage(CostedStage):
    """A stage whose output is 10 / value."""

    history: Path = Path()

    def command(self, subject: Subject, out: Path, change: Any, turn: int = 0) -> list[str]:
        return [sys.executable, "-S", "-c", PROGRAM, str(out), str(change["value"]), str(self.history)]

    def imports(self) -> list[list[str]]:
        return [[sys.executable, "-S", "-c", "pass"]]


def read_number(path: Path) -> float:
    return float(json.loads(path.read_text()))


@pytest.fixture
def turn(tmp_path, monkeypatch):
    """Runs the stage with one dial that takes the values given; returns its table and the order of its runs."""
    stage = TinyStage(
        name="index_capture", inputs=(), outputs={"value": ("value.json", "value.json")},
        metrics=(
            Metric("off", lambda s, out, true: abs(read_number(out["value"]) - read_number(true["value"])),
                   lambda s: 0.0),
        ),
        unit="numbers", work=lambda output: 1, history=tmp_path / "history",
    )  # fmt: skip

    def run_with(values, **settings) -> tuple[pd.DataFrame, list[str]]:
        monkeypatch.setattr(
            pipeline.stages.measure_cost, "DIALS", [Dial("number", stage, "value", lambda subject: values)]
        )
        run(
            results=tmp_path / "results", capture=tmp_path / "capture", out=tmp_path / "out",
            settings=MeasureCost(**settings),
        )  # fmt: skip
        return pd.read_csv(tmp_path / "out/accuracy_cost.csv"), (tmp_path / "history").read_text().split()

    return run_with


def test_against_the_reference(turn, tmp_path) -> None:
    table, order = turn([1, 2, 5], repeats=2)
    # The reference once before, then all settings in turn.
    assert order == ["5", "1", "2", "5", "1", "2", "5"]
    assert table.setting.tolist() == ["imports only", "1", "2", "5"]
    np.testing.assert_array_equal(table.error, [np.nan, 8, 3, 0])
    assert set(table.metric) == {"off (reference 5)"}
    assert table.set_index("setting").chosen.to_dict() == {"imports only": False, "1": False, "2": False, "5": True}
    assert (table.seconds > 0).all() and (table.peak_mb > 1).all()
    assert (tmp_path / "out/accuracy_cost.png").read_bytes().startswith(b"\x89PNG")


def test_against_the_truth(turn, tmp_path) -> None:
    truth = tmp_path / "capture/truth/value.json"
    truth.parent.mkdir(parents=True)
    truth.write_text("4.0")
    table, _ = turn([1, 2, 5], repeats=1)
    assert set(table.metric) == {"off (truth)"}
    np.testing.assert_array_equal(table.error, [np.nan, 6, 1, 2])
    assert table.setting[table.chosen].tolist() == ["2"]


def test_setting_that_is_refused_has_no_error(turn) -> None:
    table, _ = turn([3, 5], repeats=1)
    refused = table[table.setting == "3"].iloc[0]
    assert np.isnan(refused.error) and refused.seconds > 0 and not refused.chosen


def test_stage_that_breaks_ends_it_and_nothing_is_written(turn, tmp_path) -> None:
    with pytest.raises(InputError, match="RuntimeError: four breaks"):
        turn([4, 5], repeats=1)
    assert not (tmp_path / "out").exists()


def test_reference_that_is_refused_ends_it(turn) -> None:
    with pytest.raises(InputError, match="error: three is refused"):
        turn([5, 3], repeats=1)


def test_dial_that_does_not_exist(turn) -> None:
    with pytest.raises(InputError, match="nonsense: expected one of number, found no such dial"):
        turn([1, 5], dials=("nonsense",))


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("{", "expected JSON"),
        ("[]", "found \\[\\]"),
        ('{"track": {}}', "track: expected one of synthesize_capture"),
        (
            '{"track_mesh": {"inlier_px": -1}}',
            "track_mesh.inlier_px: expected Input should be greater than 0, found -1",
        ),
        ('{"track_mesh": {"inlier": 1}}', "track_mesh.inlier: expected Extra inputs are not permitted"),
    ],
)
def test_stage_settings_that_make_no_sense(text, complaint) -> None:
    with pytest.raises(InputError, match=complaint):
        read_stage_settings(text)


def test_workflow_hands_over_what_a_subject_changes() -> None:
    subject = SubjectSettings(track_mesh={"outline_rounds": 2}, train_avatar={"steps": 7}, unwrap_atlas={"size": 64})
    read = read_stage_settings(changed_settings(subject, COSTED_STAGES))
    changed = {stage: settings for stage, settings in read.items() if settings}
    assert changed == {"track_mesh": {"outline_rounds": 2}, "train_avatar": {"steps": 7}, "unwrap_atlas": {"size": 64}}


def test_samples_of_irradiance(tmp_path) -> None:
    """A real stage, started as its users start it; the error is computed here once more."""
    results = tmp_path / "someone"
    paths = write_posed_capture(tmp_path / "files")
    for name, place in {
        "atlas": "atlas.safetensors", "tracking": "tracking/0000.safetensors", "lights": "calibration/lights.parquet",
        "patterns": "patterns.parquet", "frames": "frames.parquet",
    }.items():  # fmt: skip
        (results / place).parent.mkdir(parents=True, exist_ok=True)
        (results / place).write_bytes(paths[name].read_bytes())
    settings = MeasureCost(dials=("irradiance_alone",), repeats=1)
    run(results=results, capture=tmp_path / "capture", out=tmp_path / "out", settings=settings)
    table = pd.read_csv(tmp_path / "out/accuracy_cost.csv").set_index("setting")
    assert table.index.tolist() == ["imports only", "1", "full"]
    maps, texels = {}, 0
    for samples in ("1", "full"):
        out = tmp_path / samples / "0000"
        alone = TraceIrradiance(samples=samples, share_rays=False)
        pipeline.stages.trace_irradiance.run(**paths, subject="someone", out=out, settings=alone)
        texels = pd.read_parquet(f"{out}.parquet").texels.sum()
        maps[samples] = [OpenEXR.File(str(path)).channels()["Y"].pixels for path in sorted(out.glob("*.exr"))]
    squares = sum(((a.astype(float) - b) ** 2).sum() for a, b in zip(maps["1"], maps["full"], strict=True))
    assert table.error["1"] == pytest.approx(np.sqrt(squares / texels), rel=1e-5)
    assert table.error["1"] > 0.05 and table.error["full"] == 0
    assert table.work["full"] > table.work["1"] > 0
    assert (table.unit == "rays").all()
    assert table.seconds["imports only"] > 0.1


CHAIN = """
import json, pathlib, sys, time
out, name, value, history = pathlib.Path(sys.argv[1]), sys.argv[2], float(sys.argv[3]), pathlib.Path(sys.argv[4])
with history.open("a") as file: file.write(name + sys.argv[3] + " ")
out.mkdir(parents=True, exist_ok=True)
time.sleep(0.3 if name in ("slow", "judge") else 0)
(out / f"{name}.json").write_text(json.dumps(10 / value))
"""


@dataclass(frozen=True)
class LongStage(CostedStage):
    """A stage whose output is 10 / value once it has been judged; a later stage that counts is slow."""

    history: Path = Path()

    def words(self, name: str, value: Any, out: Path) -> list[str]:
        return [sys.executable, "-S", "-c", CHAIN, str(out), name, str(value), str(self.history)]

    def command(self, subject: Subject, out: Path, change: Any, turn: int = 0) -> list[str]:
        seed = {**change, **self._seed(self.name, turn)}.get("seed", 0)
        return self.words("first", change["value"] * change.get("short", 1) + seed, out)

    def later_commands(self, subject: Subject, out: Path, turn: int = 0) -> dict[str, list[str]]:
        return {"slow": self.words("slow", 1, out), "judge": self.words("judge", 2, out)}

    def imports(self) -> list[list[str]]:
        return [[sys.executable, "-S", "-c", "pass"]] * 2


@pytest.fixture
def long_stage(tmp_path):
    def error(subject, output, expected):
        return abs(read_number(output["value"]) - read_number(expected["value"]))

    return LongStage(
        name="index_capture", inputs=(), outputs={"value": ("first.json", None)},
        metrics=(Metric("off", error, lambda subject: 0.5),), unit="numbers", work=lambda output: 1,
        afterwards=("slow", "judge"), timed=("slow",), warm_up={"short": 100}, history=tmp_path / "history",
    )  # fmt: skip


def test_long_stages_are_not_run_twice_for_two_dials_nor_judged_twice(long_stage, tmp_path, monkeypatch) -> None:
    """One dial ends at 5, the other at 10 and passes by 5, which runs once a round for both."""
    dials = [
        Dial("low", long_stage, "value", lambda subject: (1, 5)),
        Dial("high", long_stage, "value", lambda subject: (5, 10)),
    ]
    monkeypatch.setattr(pipeline.stages.measure_cost, "DIALS", dials)
    settings = MeasureCost(repeats=5, training_repeats=2)
    run(results=tmp_path / "results", capture=tmp_path / "capture", out=tmp_path / "out", settings=settings)
    whole = "slow1 judge2"
    rounds = [f"first5 {whole} first10 {whole} first1 {whole}", "first5 slow1 first10 slow1 first1 slow1"]
    assert (tmp_path / "history").read_text().split() == ["first500", "first1000", *" ".join(rounds).split()]
    table = pd.read_csv(tmp_path / "out/accuracy_cost.csv")
    assert table.dial.tolist() == ["low"] * 3 + ["high"] * 3
    assert table.setting.tolist() == ["imports only", "1", "5", "imports only", "5", "10"]
    np.testing.assert_array_equal(table.error, [np.nan, 8, 0, np.nan, 1, 0])
    assert table.metric.tolist() == ["off (reference 5)"] * 3 + ["off (reference 10)"] * 3
    runs = table[table.setting != "imports only"]
    # The later stage that counts takes 0.3 s, the one that judges is not counted.
    assert runs.seconds.min() > 0.3
    assert runs.seconds[runs.setting == "5"].nunique() == 1
    assert (table.option == "value").all() and (table.stage == "index_capture").all()


def test_each_run_has_a_seed_of_its_own_and_its_reference_the_same(long_stage, tmp_path, monkeypatch) -> None:
    """Run k makes 10 / (value + k): of 1 and 4 with seeds 0, 1 and 2, errors are 7.5, 3 and 5/3, each off by 0.5."""
    metric = replace(long_stage.metrics[0], scatter=lambda *files: 0.5)
    stage = replace(long_stage, seeded="index_capture", metrics=(metric,))
    monkeypatch.setattr(pipeline.stages.measure_cost, "DIALS", [Dial("low", stage, "value", lambda subject: (1, 4))])
    settings = MeasureCost(training_repeats=3)
    run(results=tmp_path / "results", capture=tmp_path / "capture", out=tmp_path / "out", settings=settings)
    whole = "slow1 judge2"
    rounds = [f"first{4 + seed} {whole} first{1 + seed} {whole}" for seed in range(3)]
    assert (tmp_path / "history").read_text().split() == ["first400", *" ".join(rounds).split()]
    table = pd.read_csv(tmp_path / "out/accuracy_cost.csv").set_index("setting")
    errors = np.array([7.5, 3, 5 / 3])
    assert table.error["1"] == pytest.approx(errors.mean()) and table.error["4"] == 0
    assert table.standard_error["1"] == pytest.approx(np.sqrt(0.25 + errors.var(ddof=1) / 3))


def test_reference_of_one_dial_is_judged_for_every_seed_in_another(long_stage, tmp_path, monkeypatch) -> None:
    """At 4, the reference of the first dial, run k makes 10 / (4 + k), and 10 / (9 + k) that of the second."""
    stage = replace(long_stage, seeded="index_capture")
    dials = [Dial(name, stage, "value", lambda subject, all=all: all) for name, all in (("a", (1, 4)), ("b", (4, 9)))]
    monkeypatch.setattr(pipeline.stages.measure_cost, "DIALS", dials)
    settings = MeasureCost(training_repeats=2)
    run(results=tmp_path / "results", capture=tmp_path / "capture", out=tmp_path / "out", settings=settings)
    table = pd.read_csv(tmp_path / "out/accuracy_cost.csv").set_index(["dial", "setting"])
    assert table.error["b", "4"] == pytest.approx(np.mean([10 / 4 - 10 / 9, 10 / 5 - 10 / 10]))
    assert table.error["a", "1"] == pytest.approx(np.mean([10 - 10 / 4, 10 / 2 - 10 / 5]))


def test_reference_may_be_none_of_the_values(turn, monkeypatch, tmp_path) -> None:
    turn([1, 5], repeats=1)
    (dial,) = pipeline.stages.measure_cost.DIALS
    monkeypatch.setattr(pipeline.stages.measure_cost, "DIALS", [replace(dial, reference={"value": 10})])
    run(
        results=tmp_path / "results", capture=tmp_path / "capture", out=tmp_path / "out",
        settings=MeasureCost(repeats=1),
    )  # fmt: skip
    table = pd.read_csv(tmp_path / "out/accuracy_cost.csv")
    np.testing.assert_array_equal(table.error, [np.nan, 9, 1])
    assert set(table.metric) == {"off (reference value 10)"}
