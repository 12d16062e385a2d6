"""Pictures and table of hard cases on the page: curves hold what the page says, and counts are those of the rows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from docs.generate.hard_case_pictures import CURVES, FOLDER, draw
from docs.generate.hard_case_table import run, shown
from pipeline.base.errors import InputError
from tests.support.results.hard_case import NAIVE_FACTOR

PICTURE_BYTES = 60_000

CLOSE = 2e-3
"""Ours from the truth, over the largest truth shown: float32 of slopes and highlights gives 1e-3 and less."""


@pytest.mark.parametrize("name", CURVES)
def test_ours_is_the_truth_where_the_naive_formula_is_not(name: str) -> None:
    curves = CURVES[name]()
    has = np.isfinite(curves.truth)
    assert np.array_equal(np.isfinite(curves.ours), has)
    logarithmic = curves.scales[1] == "log"
    scale = curves.truth if logarithmic else np.full_like(curves.at, np.abs(curves.truth[has]).max() or 100.0)
    ours, naive = (np.abs(row - curves.truth) / scale for row in (curves.ours, curves.naive))
    assert ours[has].max() < CLOSE
    wrong = ~(naive[has] < NAIVE_FACTOR * CLOSE)
    assert wrong.any() and not wrong.all()
    if not has.all():  # no truth there, but the naive formula claims one
        assert np.isfinite(curves.naive[~has]).any()


def test_page_shows_every_picture(repo_root: Path) -> None:
    page = (repo_root / "docs/reliability.md").read_text()
    for name in CURVES:
        assert f"](pictures/hard_cases/{name}.png)" in page
        assert (FOLDER / f"{name}.png").stat().st_size < PICTURE_BYTES
    assert {path.stem for path in FOLDER.glob("*.png")} == set(CURVES)


def test_picture_is_drawn_the_same_twice(tmp_path: Path) -> None:
    curves = CURVES["black_in_srgb"]()
    for name in ("one.png", "two.png"):
        draw(curves, tmp_path / name)
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "two.png").read_bytes()


ROWS = [
    {"group": "lobes", "verdict": "PASS", "value_error": 0.2, "value_bound": 1.0, "naive_error": np.inf},
    {"group": "lobes", "verdict": "PASS", "gradient_error": 0.5, "gradient_bound": 1.0},
    {"group": "lobes", "verdict": "FAIL", "value_error": 0.0, "value_bound": 0.0, "naive_error": 2.0},
    {"group": "exact", "verdict": "PASS", "value_error": 0.0, "value_bound": 0.0},
]


def test_table_counts_by_area_and_keeps_areas_that_were_not_run(tmp_path: Path) -> None:
    page, cases = tmp_path / "page.md", tmp_path / "cases.csv"
    page.write_text(
        "<!-- hard cases: begin -->\n| a |\n|---|\n| rays | 7 | 6 | 5 | 4 | 93 % |\n| lobes | 1 | 1 | 1 | 1 | 99 % |\n"
        "| all | 8 | 7 | 6 | 5 | 99 % |\n<!-- hard cases: end -->\n"
    )
    pd.DataFrame(ROWS).to_csv(cases, index=False)
    for _ in range(2):
        run(cases=cases, page=page)
        assert page.read_text().splitlines()[3:-1] == [
            "| exact | 1 | 1 | 0 | 0 | – |",
            "| lobes | 3 | 2 | 2 | 1 | 50 % |",
            "| rays | 7 | 6 | 5 | 4 | 93 % |",
            "| all | 11 | 9 | 7 | 5 | 93 % |",
        ]
    assert shown(page)["lobes"].share == 0.5


def test_table_asks_for_cases_that_were_measured(tmp_path: Path) -> None:
    page, cases = tmp_path / "page.md", tmp_path / "cases.csv"
    page.write_text("<!-- hard cases: begin -->\n<!-- hard cases: end -->\n")
    with pytest.raises(InputError, match="make hard-cases"):
        run(cases=cases, page=page)
    pd.DataFrame(ROWS).drop(columns="value_bound").to_csv(cases, index=False)
    with pytest.raises(InputError, match="value_bound"):
        run(cases=cases, page=page)
