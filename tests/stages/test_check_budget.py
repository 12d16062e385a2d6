"""The table of estimate and achievement, on results made by hand."""

from __future__ import annotations

import json
import math

import numpy as np
import pandas as pd
import pytest

from pipeline.base.errors import InputError
from pipeline.budget.estimate import Choice, Estimate
from pipeline.stages.check_budget import LOST_BY_ALL, run

METRIC = "irradiance, RMS (reference full)"


@pytest.fixture
def results(tmp_path):
    """Two chunks of one stage that took 3 and 5 seconds of processor, a stage of 20, and maps with known errors.

    The stage of 30 s was looked at after 15 s, and had taken half of that.
    """
    folder = tmp_path / "someone"
    for name in ("benchmarks", "irradiance"):
        (folder / name).mkdir(parents=True)
    jobs = {"trace_irradiance.0000": (3, 9), "trace_irradiance.0001": (5, 9), "train_avatar.full": (20, 30)}
    for name, (cpu, wall) in jobs.items():
        (folder / f"benchmarks/{name}.tsv").write_text(f"s\tcpu_time\n{wall}\t{cpu}\n")
    # The second run of a benchmark is the one that counts.
    (folder / "benchmarks/train_avatar.full.tsv").write_text("s\tcpu_time\n1\t1\n30\t10\n")
    for chunk, errors in (("0000", [0.3, 0.1]), ("0001", [0.1])):
        pd.DataFrame({"error_rms": errors}).to_parquet(folder / f"irradiance/{chunk}.parquet")
    rows = {"split": ["test", "test", "frames"], "lit": ["partial", "full", "partial"], "psnr_db": [27.0, 40.0, 50.0]}
    pd.DataFrame(rows).to_csv(folder / "metrics.csv", index=False)
    return folder


def estimate(**changes) -> str:
    choices = [
        Choice("irradiance_power", "trace_irradiance", "samples", "4", "budget", METRIC, 0.2, 0.01, 0.5),
        Choice("supersampling", "train_avatar", "supersample", "1", "budget", "PSNR lost", 10.0, 0.1, 1.0),
        Choice("texel_size", "unwrap_atlas", "texel_pixels", "0.9", "budget", "PSNR lost", 10.0, 0.1, 1.0),
        Choice("training_steps", "train_avatar", "steps", "300", "user", "PSNR lost", math.nan, 0.1, 1.0),
    ]
    given = {"budget_s": 27.0, "seconds": {"trace_irradiance": 7.0, "train_avatar": 15.0}, "choices": choices}
    made = Estimate(
        "someone", "other", **{**given, "psnr_db": math.nan, "paces": dict.fromkeys(given["seconds"], 1.0), **changes}
    )
    return json.dumps(made.as_json(), allow_nan=False)


def table_of(results, text, **settings) -> pd.DataFrame:
    out = results / "budget.csv"
    run(results=results, estimate=text, out=out, **settings)
    return pd.read_csv(out).set_index("quantity")


def test_time_and_error_side_by_side(results) -> None:
    table = table_of(results, estimate())
    assert table.achieved[["trace_irradiance", "train_avatar", "total"]].tolist() == [8, 20, 28]
    assert table.estimated[["trace_irradiance", "train_avatar", "total", "budget"]].tolist() == [7, 15, 22, 27]
    assert table.wall_seconds["total"] == 48
    # Jobs took 28 s in place of 22.
    assert table.achieved["machine_pace"] == pytest.approx(28 / 22) and pd.isna(table.verdict["machine_pace"])
    assert table.achieved["machine_pace.train_avatar"] == pytest.approx(20 / 15)
    assert pd.isna(table.verdict["machine_pace.train_avatar"])
    # 8 for 7 is within a quarter, 20 for 15 is not; 28 for a budget of 27 is not, and of 22 just within 27.5 + 1.
    verdicts = table.verdict[["trace_irradiance", "train_avatar", "total", "budget"]].tolist()
    assert verdicts == ["kept", "missed", "missed", "missed"]
    assert table.achieved["irradiance_power"] == pytest.approx(np.sqrt((0.09 + 0.01 + 0.01) / 3))
    assert table.verdict["irradiance_power"] == "kept" and table.setting["irradiance_power"] == 4
    # Nobody knows the reference here.
    assert np.isnan(table.achieved["training_steps"]) and pd.isna(table.verdict["training_steps"])
    assert (
        np.isnan(table.estimated["PSNR of partially lit test images"])
        and table.achieved["PSNR of partially lit test images"] == 27
    )


@pytest.mark.parametrize(("psnr_db", "verdict"), [(26.0, "kept"), (27.9, "kept"), (28.1, "missed")])
def test_pictures_may_be_a_quarter_of_their_error_worse(results, psnr_db, verdict) -> None:
    assert table_of(results, estimate(psnr_db=psnr_db)).verdict["PSNR of partially lit test images"] == verdict


def test_what_dials_lose_together_stands_beside_what_each_loses(results) -> None:
    """Two that each make a squared error ten times as large make it 19 times; nothing is known of the third."""
    table = table_of(results, estimate())
    assert table.estimated[["supersampling", "texel_size"]].tolist() == [10, 10]
    assert table.estimated[LOST_BY_ALL] == pytest.approx(10 * np.log10(19))
    assert np.isnan(table.achieved[LOST_BY_ALL]) and pd.isna(table.verdict[LOST_BY_ALL])


def test_stage_that_has_not_run_has_no_verdict(results) -> None:
    (results / "benchmarks/train_avatar.full.tsv").unlink()
    table = table_of(results, estimate())
    assert np.isnan(table.achieved["train_avatar"]) and np.isnan(table.achieved["total"])
    assert pd.isna(table.verdict["total"])


@pytest.mark.parametrize(("text", "said"), [("", "expected JSON"), ("[]", "expected JSON"), ("{}", "the key budget_s")])
def test_text_that_is_no_estimate(results, text, said) -> None:
    with pytest.raises(InputError, match=said):
        table_of(results, text)
