"""Errors that hard cases measure, and their table: one row per test of tests/hard_cases."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
import torch

from pipeline.base.files import written_whole

COLUMNS = (
    "case", "group", "value_error", "value_bound", "gradient_error", "gradient_bound", "verdict", "naive_error", "test",
    "unit",
)  # fmt: skip
"""`unit` is that of the value's error; empty: relative, or a plain number. Errors are empty where nothing was measured:
the case is a message, or has no gradient. What is not finite is inf."""

NAIVE_FACTOR = 10.0
"""A naive version has failed if its error is this many times the bound that the case keeps: no matter of rounding."""


class HardCase:
    """Takes down the errors of one test, and holds them against their bounds."""

    def __init__(self, record_property: Callable[[str, float | str], None]) -> None:
        """Args:
        record_property: pytest's fixture; the table reads what it recorded last under the names of its columns.
        """
        self._record_property = record_property
        self._row: dict[str, float] = {}

    def _record(self, column: str, value: float) -> None:
        self._row[column] = value
        self._record_property(column, value)

    def check(
        self,
        value_error: float | None = None,
        value_bound: float | None = None,
        gradient_error: float | None = None,
        gradient_bound: float | None = None,
        unit: str = "",
    ) -> None:
        """Assert that errors are finite and within bounds; the row keeps the worst of several calls.

        Give a bound with each error. A bound of 0 asks for exactness.
        """
        pairs = {"value": (value_error, value_bound), "gradient": (gradient_error, gradient_bound)}
        measured = {what: (float(e), float(b)) for what, (e, b) in pairs.items() if e is not None}
        for what, (error, bound) in measured.items():
            before = [self._row.get(f"{what}_{kind}") for kind in ("error", "bound")]
            if None in before or not _share(error, bound) <= _share(*before):
                self._record(f"{what}_error", error)
                self._record(f"{what}_bound", bound)
        if unit:
            self._record_property("unit", unit)
        for what, (error, bound) in measured.items():
            assert math.isfinite(error), f"the {what} is not finite"
            assert error <= bound, f"{what}: error {error:.3g}, bound {bound:.3g}"

    def naive_fails(self, error: float, what: Literal["value", "gradient"] = "value") -> None:
        """Assert that the plausible naive version of the case misses the bound or is not finite."""
        error, before = float(error), self._row.get("naive_error")
        if before is None or error > before or math.isnan(error):
            self._record("naive_error", error)
        least = NAIVE_FACTOR * self._row[f"{what}_bound"]
        assert not math.isfinite(error) or error > least, f"the naive version is right, too: error {error:.3g}"


def _share(error: float, bound: float) -> float:
    if bound > 0:
        return error / bound
    return 0.0 if error == 0 else math.inf


def worst(found: object, expected: object, scale: float | None = None) -> float:
    """Largest |found - expected| over `scale`; NaN if anything found is NaN.

    The scale is by default the largest |expected|.

    Arrays, tensors, or numbers of mpmath; in float64. If nothing but zeros is expected, the difference itself.
    """
    a, b = (_float64(values) for values in (found, expected))
    if scale is None:
        scale = float(np.abs(b).max(initial=0.0)) or 1.0
    return float(np.max(np.abs(a - b), initial=0.0)) / scale


def _float64(values: object) -> np.ndarray:
    if isinstance(values, torch.Tensor):
        return values.detach().double().numpy()
    return np.array(values, dtype=object).astype(np.float64)


class HardCaseTable:
    """Plugin of pytest that gathers the rows, prints them at the end and writes them as csv."""

    def __init__(self, path: Path) -> None:
        self.path, self.rows = path, {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Take a report of a test's set-up, call or teardown; failing at any of them is failing."""
        row = self.rows.setdefault(report.nodeid, {"verdict": "PASS"})
        recorded = {name: value for name, value in report.user_properties if name in COLUMNS}
        # Readers of csv files take nan for a missing number.
        row |= {name: math.inf if value != value else value for name, value in recorded.items()}
        if report.failed:
            row["verdict"] = "FAIL"
        elif report.skipped and row["verdict"] == "PASS":
            row["verdict"] = "SKIP"

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        rows = sorted(
            ({**_names(nodeid), **row} for nodeid, row in self.rows.items()), key=lambda row: str(row["group"])
        )  # as they stand in files, whichever process was done first
        terminalreporter.section("hard cases")
        for line in table_lines(rows):
            terminalreporter.write_line(line)
        with written_whole(self.path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, COLUMNS, restval="", lineterminator="\n")
            writer.writeheader()
            writer.writerows({key: _number(value) for key, value in row.items()} for row in rows)
        terminalreporter.write_line(f"written to {self.path}")


def table_lines(rows: list[dict[str, float | str]]) -> list[str]:
    """The table as text: group, case, errors, bounds, naive error, verdict; counts in the end."""
    header = ["group", "case", "value error (bound)", "gradient error (bound)", "naive error", "verdict"]
    body = [
        [row["group"], row["case"], _error(row, "value"), _error(row, "gradient"), _number(row.get("naive_error", "")),
         row["verdict"]]
        for row in rows
    ]  # fmt: skip
    widths = [max(len(line[k]) for line in [header, *body]) for k in range(len(header))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) for line in [header, *body]]
    passed, naive = (sum(wanted(row) for row in rows) for wanted in (_passed, lambda row: "naive_error" in row))
    counts = f"{len(rows)} cases, {passed} pass, {len(rows) - passed} do not; {naive} of them with a naive version"
    return [line.rstrip() for line in lines] + [counts]


def _passed(row: dict[str, float | str]) -> bool:
    return row["verdict"] == "PASS"


def _error(row: dict[str, float | str], what: str) -> str:
    if f"{what}_error" not in row:
        return ""
    unit = f" {row['unit']}" if what == "value" and "unit" in row else ""
    bound = f"{row[f'{what}_bound']:.0e}" if row[f"{what}_bound"] else "exact"
    return f"{row[f'{what}_error']:.1e} ({bound}){unit}"


def _number(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.3g}"


def _names(nodeid: str) -> dict[str, str]:
    """Group, case and test of a test's id: tests/hard_cases/test_GROUP.py::test_CASE[WHICH]."""
    path, _, function = nodeid.partition("::")
    name, _, which = function.partition("[")
    case = name.removeprefix("test_").replace("_", " ") + (f": {which.removesuffix(']')}" if which else "")
    return {"group": Path(path).stem.removeprefix("test_").replace("_", " "), "case": case, "test": nodeid}
