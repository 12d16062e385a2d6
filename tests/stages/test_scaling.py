"""The measurement of growing costs: jobs whose time and memory are known, and a projection of planted runs."""

from __future__ import annotations

import gc
import math
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest

from benchmarks.bench_scaling import measure, write_results
from benchmarks.scaling_cases import CASES, COUNTED, Case
from benchmarks.scaling_projection import CAPTURES, TERMS, fit_terms, product
from tests.support.figures.kept_figures import kept_figures

ARRAYS = """
import numpy as np
from benchmarks.call_cost import cost_of

MIB = 2**20
held = np.ones(16 * MIB // 8)
for megabytes in (8, 64, 8):
    print(cost_of(lambda: np.ones(megabytes * MIB // 8), 1)["peak MB"])
"""


def test_memory_is_what_the_peak_adds(repo_root):
    """Arrays of 8 to 64 MiB that are freed again: found to 1 MiB, whatever was held before, twice alike. In a process
    of its own, as the measurement has: what thousands of tests leave behind moves while it is looked at."""
    done = subprocess.run([sys.executable, "-c", ARRAYS], cwd=repo_root, capture_output=True, text=True, check=True)
    assert [float(line) for line in done.stdout.split()] == pytest.approx([8, 64, 8], abs=1.0)


@pytest.fixture
def settled():
    """What other tests left behind is no garbage that each measurement looks for."""
    gc.freeze()
    yield
    gc.unfreeze()


@pytest.mark.usefixtures("settled")
def test_sizes_run_in_turn_and_none_counts_that_comes_first(tmp_path):
    calls = []

    def prepare(folder, size):
        return {"frames": size}, lambda: calls.append(size) or sum(range(1_000_000))

    case = Case("planted", "frames", (1, 2), prepare, (0.0, ""), (0.0, ""))
    rows = pd.DataFrame(measure(case, tmp_path, 3))
    assert rows.frames.tolist() == [1, 2] * 3
    assert len(calls) > len(rows) and (rows["CPU seconds"] > 0).all()


def planted_runs() -> pd.DataFrame:
    """Runs of all cases: every term of a stage's costs has the coefficient 1e-3 over its product at the first size."""
    rows = []
    for case in CASES:
        own = dict.fromkeys(COUNTED, 16.0)
        for size in (16.0 * 2**k for k in range(6)):
            sizes = {**own, case.varied: size}
            terms = TERMS.get(case.stage, {cost: [(case.varied,)] for cost in ("CPU seconds", "peak MB")})
            costs = {
                cost: sum(1e-3 * product(sizes, term) / product(own, term) for term in products)
                for cost, products in terms.items()
            }
            rows.append({"stage": case.stage, "varied": case.varied, **sizes, **costs})
    return pd.DataFrame(rows)


def test_planted_runs_are_projected_as_planted(tmp_path):
    runs = planted_runs()
    with kept_figures() as figures:
        write_results(tmp_path, runs)
    exponents, projection = (pd.read_csv(tmp_path / f"{name}.csv") for name in ("exponents", "projection"))
    assert set(projection.capture) == set(CAPTURES) and set(projection.stage) == set(TERMS)
    grown = exponents[(exponents.stage == "pack_shards") & (exponents.cost == "CPU seconds")]
    assert grown.exponent.tolist() == pytest.approx([1.0, 1.0], abs=1e-3)
    for row in projection.itertuples():
        work = CAPTURES[row.capture][row.stage]
        for name, cost, unit in (("cpu_hours", "CPU seconds", row.jobs / 3600), ("peak_gb", "peak MB", 1 / 1024)):
            expected = sum(1e-3 * product(work.sizes, term) / 16 ** len(term) for term in TERMS[row.stage][cost])
            assert getattr(row, name) == pytest.approx(expected * unit, rel=1e-4)
            assert getattr(row, f"{name}_low") <= getattr(row, name) <= getattr(row, f"{name}_high")
    sizes = CAPTURES["RFGCA"]["pack_shards"].sizes
    assert projection.beyond[2] == pytest.approx(math.prod(size / 512 for size in sizes.values()))
    # A panel per case, the stage's name above and the size's below; dots at costs over those of the first size.
    panels = {(axes.texts[-1].get_text(), axes.get_xlabel()): axes for axes in figures["scaling.png"].axes}
    assert panels.keys() == {(case.stage, case.varied) for case in CASES}
    for (stage, varied), axes in panels.items():
        own = runs[(runs.stage == stage) & (runs.varied == varied)].sort_values(varied)
        dots = [line.get_xydata() for line in axes.get_lines() if line.get_marker() == "o"]
        for cost, drawn in zip(("CPU seconds", "peak MB"), dots, strict=True):
            expected = np.stack([own[varied], own[cost] / own[cost].iloc[0]], 1)
            np.testing.assert_allclose(drawn[drawn[:, 0].argsort()], expected)


def test_coefficients_are_found_in_noise_and_never_negative():
    runs = planted_runs().query("stage == 'pack_shards'")
    noisy = runs.assign(
        **{"CPU seconds": runs["CPU seconds"] * np.exp(0.02 * np.random.default_rng(0).normal(size=12))}
    )
    fit = fit_terms(noisy, "CPU seconds", TERMS["pack_shards"]["CPU seconds"])
    assert fit.relative_error == pytest.approx(0.02, rel=0.5)
    assert fit.coefficients.min() >= 0
    # Of the leading term; those that are small beside it are known less.
    assert fit.coefficients[-1] == pytest.approx(1e-3 / 256, rel=0.2)
