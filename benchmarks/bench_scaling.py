"""Does cost grow as predicted? Time and memory against frames, lights, texels, Gaussians and pixels.

    python -m benchmarks.bench_scaling [--out results/scaling] [--repeats 3] [--only trace_irradiance]

Stages run in this process, on one thread, again and again at doubling sizes (`benchmarks.scaling_cases`), all sizes in
turn; a first run of each, which compiles, does not count, nor does the interpreter's start. CPU seconds are of the
process, which its neighbours on the machine hardly change; memory is what a run's peak adds to what was there before.
`pipeline.metrics.scaling` fits the exponents. Writes exponents.csv (a row per stage, size and cost, with the verdict),
runs.csv (all runs), projection.csv (what the papers' captures would take), and scaling.png.
"""

from __future__ import annotations

import argparse
import logging
import tempfile
import time
from pathlib import Path

import numba
import pandas as pd
import torch

from benchmarks.call_cost import cost_of
from benchmarks.scaling_cases import CASES, COUNTED, Case
from benchmarks.scaling_projection import project
from pipeline.base.files import write_table
from pipeline.figures.scaling_plot import draw_scaling
from pipeline.metrics.cost import interleaved
from pipeline.metrics.scaling import fit_scaling

log = logging.getLogger("bench_scaling")

SHORTEST_S = 0.02
"""A job is repeated within a run until it took so long: ticks and caches then do not decide."""


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("results/scaling"), help="folder to write to")
    parser.add_argument("--repeats", type=int, default=3, help="runs of each size")
    parser.add_argument("--only", default="", help="cases whose stage begins so")
    options = parser.parse_args()
    logging.basicConfig(level=logging.WARNING, format="%(asctime)s %(name)s: %(message)s", datefmt="%H:%M:%S")
    log.setLevel(logging.INFO)
    torch.set_num_threads(1)
    numba.set_num_threads(1)
    runs = []
    with tempfile.TemporaryDirectory(prefix="bench_scaling_") as folder:
        for case in CASES:
            if case.stage.startswith(options.only):
                runs += measure(case, Path(folder), options.repeats)
    write_results(options.out, pd.DataFrame(runs))


def write_results(out: Path, runs: pd.DataFrame) -> None:
    """Everything that follows from the runs, and the runs."""
    exponents = exponent_table(runs)
    write_table(out / "runs.csv", runs)
    write_table(out / "exponents.csv", exponents)
    write_table(out / "projection.csv", project(runs, exponents))
    draw_scaling(out / "scaling.png", runs, exponents)
    print(exponents.drop(columns=["reason", "factor", "held"]).round(3).to_string(index=False))


def measure(case: Case, folder: Path, repeats: int) -> list[dict]:
    """Runs of all sizes of a case, in turn: every size of the job, and what it cost."""
    jobs, counts = [case.prepare(folder, size) for size in case.sizes], []
    jobs[0][1]()  # Compiles.
    for _, run in jobs:
        started = time.process_time()
        run()
        counts.append(max(1, round(SHORTEST_S / max(time.process_time() - started, 1e-4))))
    rows = []
    for (sizes, run), count in interleaved(list(zip(jobs, counts, strict=True)), [repeats] * len(jobs)):
        rows.append({"stage": case.stage, "varied": case.varied, **dict.fromkeys(COUNTED), **sizes,
                     **cost_of(run, count)})  # fmt: skip
    last = rows[-1]
    log.info("%s, up to %g %s: %.3g s", case.stage, last[case.varied], case.varied, last["CPU seconds"])
    return rows


def exponent_table(runs: pd.DataFrame) -> pd.DataFrame:
    """A row per case and cost: predicted and measured exponent, interval, verdict, reason."""
    rows = []
    for case in CASES:
        own = runs[(runs.stage == case.stage) & (runs.varied == case.varied)].rename(columns={case.varied: "size"})
        for cost, (predicted, reason) in {"CPU seconds": case.seconds, "peak MB": case.memory}.items():
            if own.empty:
                continue
            law = fit_scaling(own["size"].to_numpy(float), own[cost].to_numpy(float), with_fixed=predicted > 0)
            held = own[[name for name in COUNTED if name in own]].iloc[0].dropna()
            medians = own.groupby("size")[cost].median()
            rows.append({
                "stage": case.stage, "varied": case.varied, "smallest": medians.index[0], "largest": medians.index[-1],
                "held": ", ".join(sized(value, name) for name, value in held.items()), "cost": cost,
                "at_smallest": medians.iloc[0], "at_largest": medians.iloc[-1],
                "fixed": law.fixed, "factor": law.factor,
                "predicted": predicted, "exponent": law.exponent, "low": law.low, "high": law.high,
                "verdict": law.verdict(predicted, medians.index[-1] / medians.index[0]), "reason": reason,
            })  # fmt: skip
    return pd.DataFrame(rows)


def sized(value: float, name: str) -> str:
    """`1 frame`, `16,384 texels`."""
    return f"{value:,.0f} {name.removesuffix('s') if value == 1 else name}"


if __name__ == "__main__":
    main()
