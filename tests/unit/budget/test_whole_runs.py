"""Benchmarks of whole runs, on planted results."""

from __future__ import annotations

import itertools
import os
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from benchmarks import bench_budgets, bench_dials_together, bench_presets, machine_speed
from benchmarks.bench_presets import OWN
from benchmarks.machine_speed import SpeedMeter
from benchmarks.workflow_runs import keep_run
from pipeline.base.files import write_table
from pipeline.metrics.evaluation import TEST_FLAGS

GAINS = {OWN: 0.0, "draft": -1.5, "standard": 0.25, "reference": 0.5}
"""Decibels that a planted run of each preset gains on every image."""
SECONDS = {OWN: 100.0, "draft": 25.0, "standard": 125.0, "reference": 300.0}


def planted(results: Path, preset: str) -> None:
    """Scores of four validation images of two frames, a fully lit one and one of a test; and a stage's time."""
    own = np.array([30.0, 32.0, 28.0, 26.0, 99.0, 99.0])
    table = pd.DataFrame({"camera": list("ababaa"), "frame": [1, 1, 2, 2, 3, 4], "psnr_db": own})
    table["psnr_db"] += GAINS[preset] + np.array([0.1, 0.1, -0.1, -0.1, 0, 0]) * (preset != OWN)
    table = table.assign(**dict.fromkeys(TEST_FLAGS, False), validation=[True] * 5 + [False], fully_lit=False)
    table.loc[4, "fully_lit"], table.loc[5, TEST_FLAGS[0]] = True, True
    write_table(results / "metrics_per_image.parquet", table.sample(frac=1, random_state=len(preset)))
    times = pd.DataFrame({"s": [1.0], "cpu_time": [SECONDS[preset]]})
    (results / "benchmarks").mkdir(parents=True, exist_ok=True)
    times.to_csv(results / "benchmarks/train_avatar.full.tsv", sep="\t", index=False)


def test_presets_are_held_against_the_same_images_of_a_subjects_own_settings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Gains are of partially lit validation images, with the error of the two frames."""
    asked = []

    def run_workflow(target: Path, config: list[str], presets: list[str]) -> None:
        asked.append((target, config))
        planted(target.parent, Path(presets[0]).stem if presets else OWN)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(bench_presets, "run_workflow", run_workflow)
    runs = pd.DataFrame([vars(run) for run in bench_presets.run_subject("someone", ["captures=there"])])
    assert asked == [(Path("results/someone/metrics.csv"), ["captures=there"])] * 4
    assert runs.preset.tolist() == list(GAINS)
    assert runs.seconds.tolist() == list(SECONDS.values())
    np.testing.assert_allclose(runs.gained_db, list(GAINS.values()), atol=1e-12)
    np.testing.assert_allclose(runs.validation_db, 29 + np.array(list(GAINS.values())))
    # Two frames that differ by 0.2: the standard error of their mean is 0.1.
    np.testing.assert_allclose(runs.error_db[1:], 0.1)
    assert "| `someone` | `draft` | 25 | 0.25 | 27.50 | -1.50 ± 0.10 |" in bench_presets.as_markdown(runs)


def test_gain_of_one_frame_has_no_error() -> None:
    """A number that is not known is left out."""
    assert bench_presets.signed(0.254, np.nan) == "+0.25"


def test_dials_together_are_held_against_the_sums_of_each_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Texels and samples each double the squared error where they are turned, and steps change nothing.

    Together they lose 3.01 dB each as decibels sum, and make the error three times as large as squares do; in these
    runs, more.
    """
    asked: list[dict[str, dict[str, object]]] = []

    def run(target: Path, config: list[str]) -> None:
        settings = {words.partition("=")[0]: yaml.safe_load(words.partition("=")[2]) for words in config}
        asked.append(settings)
        coarse = settings["unwrap_atlas"]["texel_pixels"] == 0.9
        few = settings["train_avatar"]["supersample"] == 2
        scores = pd.Series(30.0 - 10 * np.log10(1.0 + coarse + few + 2 * (coarse and few)), index=["a", "b"])
        monkeypatch.setattr(bench_dials_together, "validation_scores", lambda results: scores)

    monkeypatch.setattr(bench_dials_together, "run_workflow", run)
    runs = pd.DataFrame([asdict(each) for each in bench_dials_together.run_subject("a", ["captures=here"])])
    assert len(asked) == 9 and all(each["captures"] == "here" for each in asked)
    assert asked[0]["unwrap_atlas"] == asked[2]["unwrap_atlas"] != asked[1]["unwrap_atlas"], "turned for good"
    assert asked[-1]["train_avatar"] == asked[0]["train_avatar"] | {"steps": 400, "supersample": 2}
    for each in runs.to_dict("records") * 2:
        keep_run(each, ["subject", "dials"], tmp_path / "runs.csv")
    kept = pd.read_csv(tmp_path / "runs.csv")
    assert kept.dials.tolist() == runs.dials.tolist(), "a run again takes the place of the one before"
    lines = bench_dials_together.as_markdown(kept).splitlines()
    assert "| `a` | texels | 3.01 |  |  |" in lines and "| `a` | steps | 0.00 |  |  |" in lines
    assert "| `a` | texels, steps | 3.01 | 3.01 | 3.01 |" in lines
    assert "| `a` | texels, supersampling | 6.99 | 6.02 | 4.77 |" in lines


def test_budgets_are_held_against_the_run_with_plenty_of_time() -> None:
    """Decibels are what is lost beyond the most accurate settings; one that bought nothing else has no line.

    The machine was 1.2 times as slow in the last run as in the one before, whose paces it was promised with. All but 40
    seconds' stages ran: 180 of 220 were 150.
    """
    columns = ("subject", "minutes", "promised_s", "achieved_s", "promised_lost_db", "validation_db", "pace")
    rows = [
        ("a", 10_000.0, 900.0, 1000.0, 0.1, 32.0, 1.1),
        ("a", 5.0, 300.0, 340.0, 0.6, 31.4, 1.1),
        ("a", 4.9, 300.0, 340.0, 0.6, 31.4, 1.1),
        ("a", 3.0, 180.0, 220.0, 1.1, 30.6, 1.1),
    ]
    fresh, meanwhile = [1000.0, 300.0, 0.0, 180.0], [0.06, 0.06, 0.09, 0.072]
    runs = pd.DataFrame(rows, columns=columns).assign(fresh_s=fresh, meanwhile_s=meanwhile)
    lines = bench_budgets.as_markdown(runs)
    assert "| `a` | 5 | 300 | 340 | 1.13 | 1.00 | 1.13 | 0.50 | 0.60 |" in lines
    assert "| `a` | 3 | 180 | 220 | 1.22 | 1.20 | 1.06 | 1.00 | 1.40 |" in lines
    assert lines[-1] == "1 of 2 within 15 % of the seconds, 2 at equal speed, 1 within 0.3 dB."


def test_stages_that_did_not_run_again_are_not_fresh(tmp_path: Path) -> None:
    """Both jobs of tracking ran since, calibration did not; what is not on the way does not count."""
    for name, age in {"calibrate_color": 10, "track_mesh.0000": -1, "track_mesh.0001": -1, "write_report": -1}.items():
        path = tmp_path / f"{name}.tsv"
        path.write_text("s\tcpu_time\n9\t4\n")
        os.utime(path, (1000 - age, 1000 - age))
    assert bench_budgets.seconds_since(1000.0, tmp_path) == 8


def test_pace_of_each_stage_is_read_from_the_last_run(tmp_path: Path) -> None:
    """A stage that did not run has none."""
    rows = {
        "train_avatar": 900.0,
        "machine_pace": 1.4,
        "machine_pace.train_avatar": 2.2346,
        "machine_pace.fit_eyes": np.nan,
    }
    pd.DataFrame({"quantity": list(rows), "achieved": list(rows.values())}).to_csv(tmp_path / "budget.csv", index=False)
    assert bench_budgets.paces_of(tmp_path) == {"train_avatar": 2.235}


def test_speed_meter_samples_until_the_end_of_its_block(monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock of its own says that the pieces of work take 1, 2, 3, ... seconds."""
    ticks = itertools.chain.from_iterable((0.0, float(seconds)) for seconds in itertools.count(1))
    monkeypatch.setattr(machine_speed, "EVERY_S", 0.0)
    monkeypatch.setattr(machine_speed, "piece_of_work", lambda matrix: 0.0)
    monkeypatch.setattr(machine_speed, "thread_time", lambda: next(ticks))
    with SpeedMeter() as meter:
        while len(meter.samples) < 3:
            time.sleep(0.001)
    taken = len(meter.samples)
    time.sleep(0.01)
    assert len(meter.samples) == taken, "it goes on after its block"
    assert meter.samples == [float(number + 1) for number in range(taken)]
    assert meter.seconds == (taken + 1) / 2
