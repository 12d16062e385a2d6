"""What is kept of a subject's measurement, read back by those who choose from it."""

from __future__ import annotations

import pandas as pd
import pytest

from pipeline.base.errors import InputError
from pipeline.budget.curves import read_curves, read_measured
from pipeline.config.project import SubjectSettings
from pipeline.dials.catalogue import DIALS
from pipeline.dials.curves import keep_curves
from pipeline.geometry.texels import write_atlas
from tests.support.avatars.sheet import make_sheet
from tests.support.results.curve_files import CURVES, write_curves, write_subjects

SETTINGS = SubjectSettings(train_avatar={"steps": 700})
ATLAS = make_sheet(4)


@pytest.fixture
def results(tmp_path):
    """A run with one dial that is chosen, and one that is not."""
    folder = tmp_path / "someone"
    (folder / "index").mkdir(parents=True)
    shared = {
        "metric": "PSNR lost",
        "allowed": 0.1,
        "peak_mb": 300.4,
        "work": 9,
        "unit": "steps",
        "stage": "train_avatar",
    }
    rows = [("training_steps", "steps", "imports only", None, None, 2.0, 9.0)]
    rows += [("training_steps", "steps", "100", 1.5, 0.03, 12.0, 50.0)]
    rows += [("training_steps", "steps", "400", 0.0, 0.0, 42.0, 60.0)]
    rows += [("dilation", "dilation_px2", "0.3", 0.5, 0.1, 12.0, 50.0)]
    names = ["dial", "option", "setting", "error", "standard_error", "cpu_seconds", "seconds"]
    pd.DataFrame([{**shared, **dict(zip(names, row, strict=True))} for row in rows]).to_csv(
        folder / "accuracy_cost.csv", index=False
    )
    metrics = {"split": ["test", "frames"], "lit": ["partial", "partial"], "psnr_db": [27.1234, 50]}
    pd.DataFrame(metrics).to_csv(folder / "metrics.csv", index=False)
    pd.DataFrame({"width": [10, 20], "height": [10, 10]}).to_parquet(folder / "index/cameras.parquet")
    pd.DataFrame({"frame": range(6)}).to_parquet(folder / "index/frames.parquet")
    (folder / "index/capture.json").write_text('{"kind": "head"}')
    (folder / "effects.json").write_text('{"learned_transport": {"on": true}}')
    write_atlas(folder / "atlas.safetensors", ATLAS)
    return folder


def test_curves_of_what_is_chosen_with_seconds_of_a_processor(results, tmp_path) -> None:
    keep_curves(DIALS, SETTINGS, results, tmp_path / "kept")
    (whole,) = read_curves(tmp_path / "kept/accuracy_cost.csv")
    assert (whole.dial, whole.stage, whole.option) == ("training_steps", "train_avatar", "steps")
    (curve,) = whole.parts
    assert (curve.subject, curve.scatters) == ("someone", (0.03, 0.0))
    assert (curve.settings, curve.errors, curve.seconds) == (("100", "400"), (1.5, 0.0), (12.0, 42.0))
    assert (curve.imports, curve.allowed) == (2.0, 0.1)
    (measured,) = read_measured(tmp_path / "kept/subjects.yaml")
    assert (measured.kind, measured.material, measured.texels) == ("head", "translucent", ATLAS.texel_count)
    assert (measured.subject, measured.cameras, measured.frames, measured.pixels) == ("someone", 2, 6, 150)
    assert measured.psnr_db == 27.123
    assert measured.settings == {"training_steps": 700}
    # Between two numbers in proportion, and beyond them.
    assert (curve.work(250), curve.work(400), curve.work(800)) == pytest.approx((25, 40, 80))


def test_run_that_is_not_whole(results, tmp_path) -> None:
    (results / "metrics.csv").unlink()
    with pytest.raises(InputError, match=r"metrics\.csv: expected the results of a whole run"):
        keep_curves(DIALS, SETTINGS, results, tmp_path / "kept")


def test_table_without_a_dial_that_is_chosen(results, tmp_path) -> None:
    path = results / "accuracy_cost.csv"
    path.write_text(path.read_text().replace("training_steps", "compensation"))
    with pytest.raises(InputError, match="expected some of the dials irradiance_power, trained_outlines"):
        keep_curves(DIALS, SETTINGS, results, tmp_path / "kept")


def test_curves_of_other_subjects_stay_and_its_own_are_written_anew(results, tmp_path) -> None:
    out = write_curves(tmp_path / "kept").parent
    for _ in range(2):
        keep_curves(DIALS, SETTINGS, results, out)
    assert [one.subject for one in read_measured(out / "subjects.yaml")] == ["measured", "someone"]
    parts = {curve.dial: [part.subject for part in curve.parts] for curve in read_curves(out / "accuracy_cost.csv")}
    assert parts["training_steps"] == ["measured", "someone"]
    assert parts["supersampling"] == ["measured"]
    assert list(parts) == ["irradiance_power", "supersampling", "training_steps", "environment_shadows"]


def test_its_own_dials_that_were_not_measured_now_stay(results, tmp_path) -> None:
    out = write_subjects(tmp_path / "kept", {"someone": CURVES}).parent
    keep_curves(DIALS, SETTINGS, results, out)
    kept = {curve.dial: curve for curve in read_curves(out / "accuracy_cost.csv")}
    assert list(kept) == ["irradiance_power", "supersampling", "training_steps", "environment_shadows"]
    assert kept["training_steps"].parts[0].errors == (1.5, 0.0)
    assert kept["supersampling"].parts[0].errors == (0.5, 0.01)
    (measured,) = read_measured(out / "subjects.yaml")
    assert measured.settings["training_steps"] == 700
    assert measured.settings["supersampling"] == SETTINGS.train_avatar.supersample


def test_order_is_that_of_names_whoever_was_measured_last(results, tmp_path) -> None:
    out = write_curves(tmp_path / "kept").parent
    first = results.rename(results.parent / "another")
    keep_curves(DIALS, SETTINGS, first, out)
    assert [one.subject for one in read_measured(out / "subjects.yaml")] == ["another", "measured"]
    parts = {curve.dial: [part.subject for part in curve.parts] for curve in read_curves(out / "accuracy_cost.csv")}
    assert parts["training_steps"] == ["another", "measured"]
