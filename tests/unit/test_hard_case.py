"""The table of hard cases tells passing from failing ones, and a naive version that works from one that does not."""

from __future__ import annotations

import csv
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.support.results.hard_case import COLUMNS, HardCase, worst

CASES = """
import pytest

@pytest.mark.parametrize("length", [0.0, 1e3])
def test_good(case, length):
    case.check(1e-9, 1e-6, 2e-9, 1e-6, unit="mm")
    case.check(1e-8, 1e-6)
    case.naive_fails(float("nan"))

def test_bad(case):
    case.check(0.5, 0.1)

def test_broken(case, no_such_fixture):
    pass

@pytest.mark.skip
def test_left_out():
    pass
"""


@pytest.fixture
def case() -> HardCase:
    return HardCase(lambda column, value: None)


def test_table_is_printed_and_written(tmp_path: Path, repo_root: Path) -> None:
    folder = tmp_path / "hard_cases"
    folder.mkdir()
    (folder / "conftest.py").write_text((repo_root / "tests/hard_cases/conftest.py").read_text())
    (folder / "test_some_group.py").write_text(CASES)
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "hard_cases",
        "--hard-cases",
        "out/table.csv",
    ]
    run = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, env={"PYTHONPATH": str(repo_root), "PATH": ""}
    )
    assert run.returncode == 1
    assert "5 cases, 2 pass, 3 do not; 2 of them with a naive version" in run.stdout
    assert "1.0e-08 (1e-06) mm 2.0e-09 (1e-06) inf PASS" in " ".join(run.stdout.split())
    with (tmp_path / "out/table.csv").open() as file:
        rows = {row["case"]: row for row in csv.DictReader(file)}
    assert list(next(iter(rows.values()))) == list(COLUMNS)
    assert {name: row["verdict"] for name, row in rows.items()} == {
        "good: 0.0": "PASS", "good: 1000.0": "PASS", "bad": "FAIL", "broken": "FAIL", "left out": "SKIP",
    }  # fmt: skip
    good = rows["good: 0.0"]
    assert good == {
        "case": "good: 0.0", "group": "some group", "value_error": "1e-08", "value_bound": "1e-06",
        "gradient_error": "2e-09", "gradient_bound": "1e-06", "verdict": "PASS", "naive_error": "inf",
        "test": "hard_cases/test_some_group.py::test_good[0.0]", "unit": "mm",
    }  # fmt: skip
    assert rows["bad"]["value_error"] == "0.5"
    assert rows["broken"]["value_error"] == ""


@pytest.mark.parametrize("error", [0.2, np.nan, np.inf])
def test_errors_beyond_their_bound_fail(case: HardCase, error: float) -> None:
    with pytest.raises(AssertionError):
        case.check(error, 0.1)
    with pytest.raises(AssertionError):
        case.check(0.0, 0.1, gradient_error=error, gradient_bound=0.1)


def test_a_naive_version_that_works_is_no_hard_case(case: HardCase) -> None:
    case.check(1e-9, 1e-6)
    with pytest.raises(AssertionError, match="naive"):
        case.naive_fails(5e-6)
    for error in (1e-3, np.nan, np.inf):
        case.naive_fails(error)


def test_worst_error_is_no_number_if_one_entry_is_none() -> None:
    assert np.isnan(worst(torch.tensor([1.0, torch.nan]), [1.0, 2.0]))
    assert worst([1.0, 2.5], [1.0, 2.0]) == 0.25
    assert worst([0.1], [0.0]) == 0.1
