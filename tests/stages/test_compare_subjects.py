"""Several planted subjects: the table, the page, and what is refused. (What is tested: tests/unit/metrics.)"""

from __future__ import annotations

import pandas as pd
import pytest

from pipeline.base.errors import InputError
from pipeline.config.compare_subjects import CompareSubjects
from pipeline.metrics.ablation_table import ALL, COLUMNS
from pipeline.stages.compare_subjects import run
from tests.support.results.reported_results import scores


@pytest.fixture
def files(tmp_path):
    """Of three subjects of which the last has no third avatar."""
    effects = {"full": 0.0, "matte": -1.0, "pbr": 0.0}
    paths = []
    for name in ("ann", "bobby", "eve"):
        own = {key: value for key, value in effects.items() if name != "eve" or key != "pbr"}
        paths.append(tmp_path / f"{name}.parquet")
        scores(own, name).to_parquet(paths[-1])
    return tuple(paths)


def test_table_and_page_say_what_was_planted(files, tmp_path):
    run(scores=files, out=tmp_path / "out")
    table = pd.read_csv(tmp_path / "out/comparison.csv")
    assert table.columns.tolist() == COLUMNS
    rows = table[(table.lit == "all") & (table.metric == "psnr_db")].set_index(["subject", "variant"])
    matte = rows.loc[(ALL, "matte")]
    assert matte.difference == pytest.approx(-1.0, abs=0.02)
    assert matte.subjects == 3 and matte.images == 96 and matte.baseline == "full"
    assert matte.p_holm < 0.001 and matte.new_p_value < 0.01
    assert rows.loc[(ALL, "pbr")].subjects == 2
    assert ("eve", "pbr") not in rows.index
    page = (tmp_path / "out/comparison/index.html").read_text()
    assert "ann, bobby, eve; avatars against full" in page
    assert "worse" in page and "better" not in page.replace("called better or worse", "")
    assert "default-src" in page and "://" not in page


def test_one_subject_is_no_comparison_but_has_its_tests(files, tmp_path):
    run(scores=files[:1], out=tmp_path)
    table = pd.read_csv(tmp_path / "comparison.csv")
    assert set(table.subject) == {"ann"} and table.new_p_value.isna().all()
    assert "there is only one subject" in (tmp_path / "comparison/index.html").read_text()


def test_baseline_is_chosen_and_has_to_be_there(files, tmp_path):
    run(scores=files, out=tmp_path, settings=CompareSubjects(baseline="matte"))
    table = pd.read_csv(tmp_path / "comparison.csv")
    chosen = table[(table.subject == ALL) & (table.variant == "full") & (table.lit == "all")].set_index("metric")
    assert chosen.difference["psnr_db"] == pytest.approx(1.0, abs=0.02)
    with pytest.raises(InputError, match="eve: expected a variant 'pbr'"):
        run(scores=files, out=tmp_path, settings=CompareSubjects(baseline="pbr"))


def test_the_same_subject_twice_is_refused(files, tmp_path):
    with pytest.raises(InputError, match="one table per subject, found ann, ann"):
        run(scores=(files[0], files[0]), out=tmp_path)
