"""Keeps a subject's measured curves as those that presets and budgets choose from.

    python -m pipeline.dials.curves --results results/subjectA

Writes config/curves/accuracy_cost.csv, the rows of its table of that name for the dials that are to be chosen, and
config/curves/subject.yaml, what the subject was like and what its stages took. Seconds are a processor's.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd
import yaml

from pipeline.base.code_digest import ROOT
from pipeline.base.command import run_as_command
from pipeline.base.errors import InputError
from pipeline.base.files import read_table, write_table, written_whole
from pipeline.budget.allocation import SCALES_WITH
from pipeline.budget.curves import COLUMNS, FOLDER
from pipeline.config.loading import load_project
from pipeline.config.project import SubjectSettings
from pipeline.dials.catalogue import DIALS
from pipeline.dials.dial import Dial


def keep_curves(dials: Sequence[Dial], settings: SubjectSettings, results: Path, out: Path) -> None:
    """Write both files to `out` from a subject's results.

    These need accuracy_cost.csv, benchmarks and metrics.csv.

    Raises:
        InputError: if one of them is missing, or no dial to be chosen was measured.
    """
    names = [dial.name for dial in dials if dial.chosen]
    for path in ("accuracy_cost.csv", "metrics.csv", "benchmarks"):
        if not (results / path).exists():
            raise InputError(f"{results / path}: expected the results of a whole run, found no such file")
    table = pd.read_csv(results / "accuracy_cost.csv")
    table = table[table.dial.isin(names)].sort_values("dial", key=lambda dials: dials.map(names.index), kind="stable")
    if table.empty:
        raise InputError(f"{results}/accuracy_cost.csv: expected some of the dials {', '.join(names)}, found none")
    kept = table.assign(seconds=table.cpu_seconds)[[*COLUMNS, "peak_mb", "work", "unit"]]
    write_table(out / "accuracy_cost.csv", kept.round({"seconds": 3, "peak_mb": 0}))
    used = {
        dial.name: getattr(getattr(settings, dial.stage.name), dial.setting)
        for dial in dials
        if dial.name in set(kept.dial)
    }
    with written_whole(out / "subject.yaml") as path:
        path.write_text(HEADER + yaml.safe_dump(subject_facts(results, used), sort_keys=False))


HEADER = """\
# What the subject of accuracy_cost.csv was like, and what its stages took with its own settings, in seconds of a
# processor. Written by `make curves`.
"""


def subject_facts(results: Path, used: dict[str, Any]) -> dict[str, Any]:
    """The fields of `pipeline.budget.curves.Measured`."""
    cameras = read_table(results / "index/cameras.parquet")
    metrics = pd.read_csv(results / "metrics.csv")
    psnr = metrics.psnr_db[(metrics.split == "test") & (metrics.lit == "partial")]
    seconds = {stage: benchmark_seconds(results / "benchmarks", stage) for stage in SCALES_WITH}
    return {
        "subject": results.resolve().name,
        "cameras": len(cameras),
        "frames": len(read_table(results / "index/frames.parquet")),
        "pixels": round(float((cameras.width * cameras.height).mean())),
        "psnr_db": round(float(psnr.iloc[0]), 3),
        "settings": used,
        "seconds": {stage: value for stage, value in seconds.items() if value},
    }


def benchmark_seconds(folder: Path, stage: str) -> float:
    """Seconds of a processor that all jobs of a stage took; 0 if it has not run."""
    tables = [pd.read_csv(path, sep="\t") for path in folder.glob("*.tsv") if path.name.partition(".")[0] == stage]
    return round(sum((float(table.cpu_time.iloc[-1]) for table in tables), 0.0), 2)


def main() -> None:
    """Command line: `--results results/SUBJECT`, a run without changes to the configuration."""
    run_as_command(run)


def run(*, results: Path) -> None:
    """Keep the curves of a subject.

    Args:
        results: with accuracy_cost.csv, metrics.csv and benchmarks.
    """
    defaults = yaml.safe_load((ROOT / "config/config.yaml").read_text())
    settings = load_project(defaults, {}, ROOT / "config/subjects").subject(results.resolve().name)
    keep_curves(DIALS, settings, results, ROOT / FOLDER)


if __name__ == "__main__":
    main()
