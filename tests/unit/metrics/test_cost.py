"""Pareto front, tolerance and table on numbers made by hand."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.metrics.cost import (
    COLUMNS,
    IMPORTS_ONLY,
    Cost,
    cheapest_within,
    cost_table,
    interleaved,
    largest_allowed,
    pareto_front,
)


def test_runs_are_interleaved() -> None:
    assert list(interleaved("ABC", [3, 1, 2])) == list("ABCACA")


@pytest.mark.parametrize(
    ("seconds", "error", "front"),
    [
        ([1, 2, 3], [3, 2, 1], [True, True, True]),
        ([1, 2, 3], [1, 2, 3], [True, False, False]),
        # Slower than the second and as wrong as it; as fast as the fourth and more wrong.
        ([1, 2, 3, 4, 4], [5, 4, 4, 1, 2], [True, True, False, True, False]),
        # Two that are the same hide each other not.
        ([2, 2, 3], [1, 1, 2], [True, True, False]),
        ([1, 2, 3], [np.nan, 2, np.nan], [False, True, False]),
        ([1], [0], [True]),
    ],
)
def test_pareto_front(seconds, error, front) -> None:
    assert pareto_front(np.array(seconds, float), np.array(error, float)).tolist() == front


@pytest.mark.parametrize(
    ("error", "relative", "absolute", "allowed"),
    [
        ([2.0, 5.0], 0.1, 0.0, 2.2),
        ([2.0, 5.0], 0.1, 3.0, 3.0),
        ([0.0, 5.0], 0.1, 0.5, 0.5),
        ([np.nan, 2.0], 0.5, 0.0, 3.0),
        ([np.nan], 0.5, 0.25, 0.25),
    ],
)
def test_largest_allowed(error, relative, absolute, allowed) -> None:
    assert largest_allowed(np.array(error), relative, absolute) == pytest.approx(allowed)


class TestCheapestWithin:
    def choose(self, seconds, error, limit, spread=0.0):
        seconds = np.array(seconds, float)
        return cheapest_within(seconds, seconds - spread / 2, seconds + spread / 2, np.array(error, float), limit)

    def test_fastest_of_those_allowed(self) -> None:
        assert self.choose([1, 2, 3, 4], [9, 1.05, 1.0, 1.02], 1.1) == 1

    def test_error_at_the_limit_is_allowed(self) -> None:
        assert self.choose([1, 2], [1.1, 1.0], 1.1) == 0

    def test_none_is_allowed(self) -> None:
        assert self.choose([1, 2], [2.0, np.nan], 1.0) is None

    def test_more_accurate_of_two_whose_times_overlap(self) -> None:
        assert self.choose([1.0, 1.1, 3.0], [1.05, 1.01, 1.0], 1.1, spread=0.2) == 1
        assert self.choose([1.0, 1.1, 3.0], [1.05, 1.01, 1.0], 1.1, spread=0.05) == 0

    def test_faster_of_two_that_overlap_and_are_equal(self) -> None:
        assert self.choose([1.1, 1.0], [1.0, 1.0], 1.1, spread=0.5) == 1


def cost(setting, seconds, near=None, far=None, tolerance=0.0):
    errors = {} if near is None else {"near": near, "far": far}
    cpu = [2 * second for second in seconds]
    return Cost(
        "speed", setting, {"near": tolerance, "far": 100.0}, "steps", work=7, seconds=seconds, cpu_seconds=cpu,
        peak_mb=[50.0, 70.0, 60.0], errors=errors,
    )  # fmt: skip


class TestTable:
    @pytest.fixture
    def table(self):
        costs = [
            cost(IMPORTS_ONLY, [0.5, 0.5, 0.5]),
            cost("coarse", [1.0, 5.0, 2.0], [3.0, 3.0, 3.0], [30.0, 30.0, 30.0]),
            cost("fine", [4.0, 4.0, 4.0], [1.0, 1.2, 1.1], [20.0, 20.0, 20.0]),
            cost("refused", [0.8, 0.8, 0.8]),
        ]
        return cost_table(costs, 0.1)

    def test_one_row_per_setting_and_metric(self, table) -> None:
        assert list(table.columns) == COLUMNS
        expected = [(s, m) for s in (IMPORTS_ONLY, "coarse", "fine", "refused") for m in ("near", "far")]
        assert list(zip(table.setting, table.metric, strict=True)) == expected

    def test_statistics(self, table) -> None:
        row = table[(table.setting == "coarse") & (table.metric == "near")].iloc[0]
        # Quartiles of 1, 2, 5: half way to the median on either side.
        assert (row.seconds, row.seconds_low, row.seconds_high, row.seconds_spread) == (2.0, 1.5, 3.5, 2.0)
        assert (row.cpu_seconds, row.peak_mb, row.work, row.unit, row.error) == (4.0, 70.0, 7, "steps", 3.0)
        assert table.error[(table.setting == "fine") & (table.metric == "near")].item() == 1.1

    def test_choice_is_per_metric(self, table) -> None:
        chosen = {row.metric: (row.setting, row.allowed) for row in table[table.chosen].itertuples()}
        # Near: 10 % above 1.1. Far: up to 100 nobody minds, and the coarse setting is faster.
        assert chosen == {"near": ("fine", pytest.approx(1.21)), "far": ("coarse", 100.0)}

    def test_what_has_no_error_is_neither_on_the_front_nor_chosen(self, table) -> None:
        without = table[table.setting.isin([IMPORTS_ONLY, "refused"])]
        assert without.error.isna().all()
        assert not (without.pareto | without.chosen).any()
        assert table[table.metric == "near"].pareto.tolist() == [False, True, True, False]


@pytest.mark.parametrize(
    ("errors", "scatters", "expected"),
    [
        ([1.0], [0.3], 0.3),
        ([1.0, 3.0], [0.3, 0.5], np.sqrt((0.09 + 0.25) / 2 + 2 / 2)),
        ([1.0, 3.0], [np.nan, np.nan], 1.0),  # images of one frame: what is known is over the runs
        ([1.0], [np.nan], np.nan),
        ([1.0, 3.0], [], 1.0),
    ],
)
def test_standard_error_is_over_frames_and_runs(errors, scatters, expected) -> None:
    known = {"PSNR": scatters} if scatters else {}
    cost = Cost("steps", "100", {"PSNR": 0.1}, "steps", errors={"PSNR": errors}, scatters=known)
    assert cost.standard_error("PSNR") == pytest.approx(expected, nan_ok=True)
