"""Keeps a subject's measured curves among those that presets and budgets choose from.

    python -m pipeline.dials.curves --results results/subjectA

Writes config/curves/accuracy_cost.csv, the rows of its table of that name for the dials that are to be chosen, and
config/curves/subjects.yaml, what the subject is like. What other subjects have there stays, and what this one has of
dials that were not measured now; all are in order of their names. Seconds are a processor's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd
import yaml

from pipeline.base.code_digest import ROOT
from pipeline.base.command import run_as_command
from pipeline.base.errors import InputError
from pipeline.base.files import read_json, read_table, write_table, written_whole
from pipeline.budget.curves import COLUMNS, FOLDER, Measured, read_measured
from pipeline.config.loading import load_project
from pipeline.config.project import SubjectSettings
from pipeline.dials.catalogue import DIALS
from pipeline.dials.dial import Dial
from pipeline.geometry.texels import read_atlas

KEPT = [*COLUMNS, "unit", "peak_mb"]


def keep_curves(dials: Sequence[Dial], settings: SubjectSettings, results: Path, out: Path) -> None:
    """Write both files to `out`, or add to them, from a subject's results.

    These need accuracy_cost.csv and metrics.csv.

    Raises:
        InputError: if one of them is missing, or no dial to be chosen was measured.
    """
    names, subject = [dial.name for dial in dials if dial.chosen], results.resolve().name
    for path in ("accuracy_cost.csv", "metrics.csv"):
        if not (results / path).exists():
            raise InputError(f"{results / path}: expected the results of a whole run, found no such file")
    table = pd.read_csv(results / "accuracy_cost.csv", dtype={"setting": str})
    table = table[table.dial.isin(names)]
    if table.empty:
        raise InputError(f"{results}/accuracy_cost.csv: expected some of the dials {', '.join(names)}, found none")
    kept = table.assign(seconds=table.cpu_seconds, subject=subject)[KEPT].round({"seconds": 3, "peak_mb": 0})
    others: list[Measured] = []
    if (out / "subjects.yaml").exists():
        others = [one for one in read_measured(out / "subjects.yaml") if one.subject != subject]
        before = pd.read_csv(out / "accuracy_cost.csv", dtype={"setting": str})
        kept = pd.concat([before[(before.subject != subject) | ~before.dial.isin(kept.dial)], kept])
    kept = kept[kept.dial.isin(names)].sort_values("subject", kind="stable")
    own = set(kept.dial[kept.subject == subject])
    used = {dial.name: getattr(getattr(settings, dial.stage.name), dial.setting) for dial in dials if dial.name in own}
    facts = subject_facts(results, used)
    order = {name: place for place, name in enumerate(names)}
    kept = kept.sort_values("dial", key=lambda dials: dials.map(order), kind="stable")
    write_table(out / "accuracy_cost.csv", kept)
    with written_whole(out / "subjects.yaml") as path:
        content = [asdict(one) for one in sorted([*others, facts], key=lambda one: one.subject)]
        path.write_text(HEADER + yaml.safe_dump(content, sort_keys=False))


HEADER = """\
# What the subjects of accuracy_cost.csv are like, and their own settings. Written by `make curves`.
"""


def subject_facts(results: Path, used: dict[str, Any]) -> Measured:
    """The facts of a subject."""
    cameras, metrics = read_table(results / "index/cameras.parquet"), pd.read_csv(results / "metrics.csv")
    psnr = metrics.psnr_db[(metrics.split == "test") & (metrics.lit == "partial")]
    return Measured(
        subject=results.resolve().name,
        kind=read_json(results / "index/capture.json")["kind"],
        cameras=len(cameras),
        frames=len(read_table(results / "index/frames.parquet")),
        pixels=round(float((cameras.width * cameras.height).mean())),
        texels=read_atlas(results / "atlas.safetensors").texel_count,
        psnr_db=round(float(psnr.iloc[0]), 3),
        settings=used,
        material="translucent" if read_json(results / "effects.json")["learned_transport"]["on"] else "opaque",
    )


def main() -> None:
    """Command line: `--results results/SUBJECT`, a run without changes to the configuration."""
    run_as_command(run)


def run(*, results: Path) -> None:
    """Keep the curves of a subject.

    Args:
        results: with accuracy_cost.csv and metrics.csv.
    """
    defaults = yaml.safe_load((ROOT / "config/config.yaml").read_text())
    settings = load_project(defaults, {}, ROOT / "config/subjects").subject(results.resolve().name)
    keep_curves(DIALS, settings, results, ROOT / FOLDER)


if __name__ == "__main__":
    main()
