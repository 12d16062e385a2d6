"""Measure accuracy against time: every setting of every dial, run several times.

The error is against the truth where it is known.

A dial is one setting of one stage (`pipeline.dials`). The stage is run as a process of its own, as a user would, with
all else as the workflow has it. Its output is compared with the truth where the capture knows it (metrics marked
`truth`), else with what the dial's last, finest value gives (`reference`, with that value). Runs are interleaved: all
settings once, then all again, trainings each time from another seed; what several dials ask for runs once for all of
them. Avatars are compared on validation images. Writes accuracy_cost.csv (see `pipeline.metrics.cost.cost_table`) and
accuracy_cost.png.
"""

from __future__ import annotations

import logging
import tempfile
from collections import Counter
from pathlib import Path

from pipeline.base.command import run_as_command
from pipeline.base.files import write_table
from pipeline.config.measure_cost import MeasureCost
from pipeline.config.stage_settings import read_stage_settings
from pipeline.dials.catalogue import DIALS
from pipeline.dials.dial import possible_dials
from pipeline.dials.jobs import judge, kept_in, measure, merged, prepare
from pipeline.dials.subject import Subject
from pipeline.metrics.cost import cost_table, interleaved

log = logging.getLogger("measure_cost")


def run(
    *, results: Path, capture: Path, out: Path, threads: int = 1, chunk_size: int = 64, variant: str = "full",
    stage_settings: str = "{}", settings: MeasureCost = MeasureCost(),
) -> None:  # fmt: skip
    """Measure what each setting of each dial costs, and how wrong the output is.

    Args:
        results: the subject's results, results/SUBJECT: what the stages read.
        capture: folder of the capture; the truth is looked for in its folder truth.
        out: folder to write accuracy_cost.csv and accuracy_cost.png to.
        threads: that each stage may use.
        chunk_size: frames of the one chunk on which stages that work chunk by chunk are measured.
        variant: avatar that is relit.
        stage_settings: JSON, what differs from the stages' defaults: {"track_mesh": {"outline_rounds": 3}}.
    """
    changed = read_stage_settings(stage_settings)
    with tempfile.TemporaryDirectory(prefix="measure_cost_") as name:
        folder = Path(name)
        # Absolute, though stages are started where this one was: temporary folders are elsewhere.
        subject = Subject(
            results.resolve(), capture.resolve(), threads, chunk_size, changed, folder / "made", variant
        )  # fmt: skip
        dials, left_out = possible_dials(DIALS, settings.dials, subject)
        for reason in left_out if not settings.dials else []:
            log.info("left out: %s", reason)
        asked = [job for dial in dials for job in prepare(dial, subject, folder / dial.name)]
        jobs = merged(asked, subject)
        repeats = [settings.repeats if job.stage.warm_up is None else settings.training_repeats for job in jobs]
        turns: Counter[int] = Counter()
        for number, job in enumerate(interleaved(jobs, repeats), 1):
            said = measure(job, subject, folder / "run", turns[id(job)])
            turns[id(job)] += 1
            names = ", ".join(f"{cost.dial} {cost.setting}" for cost, _ in job.costs)
            log.info("run %d of %d: %s: %s", number, sum(repeats), names, said)
        for job in jobs:
            for turn in range(turns[id(job)] if job.stage.seeded else 1) if job.keep else ():
                judge(job, subject, job.stage.written(kept_in(job.stage, job.keep, turn)), turn)
    table = cost_table([cost for job in asked for cost, _ in job.costs], settings.relative_tolerance)
    for row in table[table.chosen].itertuples():
        log.info("%s: %s will do: %s %.3g, %.2f s", row.dial, row.setting, row.metric, row.error, row.seconds)
    write_table(out / "accuracy_cost.csv", table)
    from pipeline.figures.cost_plot import draw_costs  # Matplotlib, once there is something to draw.

    draw_costs(out / "accuracy_cost.png", table, settings.repeats)


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
