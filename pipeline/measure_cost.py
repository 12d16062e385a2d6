"""What accuracy costs in time: every setting of every dial, run several times, its error against the truth.

A dial is one setting of one stage (`pipeline.dials`). The stage is run as a process of its own, as a user would, with
all else as the workflow has it. Its output is compared with the truth where the capture knows it (metrics marked
`truth`), else with what the dial's last, finest value gives (`reference`). Runs are interleaved: all settings once,
then all again. Writes accuracy_cost.csv (see `pipeline.metrics.cost.cost_table`) and accuracy_cost.png.
"""

from __future__ import annotations

import json
import logging
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from pipeline.base.command import run_as_command
from pipeline.base.errors import Complaints, InputError
from pipeline.base.files import write_table
from pipeline.config.measure_cost import MeasureCost
from pipeline.config.project import SECTIONS
from pipeline.dials.calibration import CALIBRATION_DIALS
from pipeline.dials.dial import Dial, Files, Subject, possible_dials
from pipeline.dials.irradiance import IRRADIANCE_DIALS
from pipeline.dials.splatting import SPLATTING_DIALS
from pipeline.dials.tracking import TRACKING_DIALS
from pipeline.dials.trained import TRAINED_DIALS
from pipeline.figures.cost_plot import draw_costs
from pipeline.metrics.cost import IMPORTS_ONLY, Cost, cost_table, interleaved
from pipeline.metrics.measured_run import MeasuredRun, run_measured

log = logging.getLogger("measure_cost")

DIALS: list[Dial] = [*CALIBRATION_DIALS, *TRACKING_DIALS, *IRRADIANCE_DIALS, *TRAINED_DIALS, *SPLATTING_DIALS]
"""All dials, in data order."""


@dataclass(frozen=True)
class Job:
    """One setting of a dial, and what its output is compared with; with nothing: the stage is only imported."""

    dial: Dial
    value: Any
    expected: Files | None
    cost: Cost


def run(
    *, results: Path, capture: Path, out: Path, threads: int = 1, chunk_size: int = 64, stage_settings: str = "{}",
    settings: MeasureCost = MeasureCost(),
) -> None:  # fmt: skip
    """Measure what each setting of each dial costs, and how wrong the output is.

    Args:
        results: the subject's results, results/SUBJECT: what the stages read.
        capture: folder of the capture; the truth is looked for in its folder truth.
        out: folder to write accuracy_cost.csv and accuracy_cost.png to.
        threads: that each stage may use.
        chunk_size: frames of the one chunk on which stages that work chunk by chunk are measured.
        stage_settings: JSON, what differs from the stages' defaults: {"track_mesh": {"outline_rounds": 3}}.
    """
    # Absolute, though stages are started where this one was: temporary folders are elsewhere.
    subject = Subject(results.resolve(), capture.resolve(), threads, chunk_size, read_stage_settings(stage_settings))
    dials, left_out = possible_dials(DIALS, settings.dials, subject)
    for reason in left_out if not settings.dials else []:
        log.info("left out: %s", reason)
    with tempfile.TemporaryDirectory(prefix="measure_cost_") as folder:
        jobs = [job for dial in dials for job in prepare(dial, subject, Path(folder, dial.name))]
        runs = len(jobs) * settings.repeats
        for number, job in enumerate(interleaved(jobs, settings.repeats), 1):
            done = measure(job, subject, Path(folder, "run"))
            text = "run %d of %d: %s %s: %.2f s, %.0f MB%s"
            refused = f", refused: {done.last_lines.splitlines()[-1]}" if done.refused else ""
            log.info(text, number, runs, job.dial.name, job.cost.setting, done.seconds, done.peak_mb, refused)
    table = cost_table([job.cost for job in jobs], settings.relative_tolerance)
    for row in table[table.chosen].itertuples():
        log.info("%s: %s will do: %s %.3g, %.2f s", row.dial, row.setting, row.metric, row.error, row.seconds)
    write_table(out / "accuracy_cost.csv", table)
    draw_costs(out / "accuracy_cost.png", table, settings.repeats)


def read_stage_settings(text: str) -> dict[str, dict[str, Any]]:
    """Stage -> settings that differ from its defaults.

    Raises:
        InputError: naming every stage and key that is not as the stage's settings want it.
    """
    complaints = Complaints("--stage-settings")
    try:
        given = json.loads(text)
    except ValueError as error:
        raise InputError(f"--stage-settings: expected JSON, found: {error}") from error
    if not isinstance(given, dict):
        raise InputError(f"--stage-settings: expected {{stage: {{setting: value}}}}, found {text}")
    for stage, values in given.items():
        try:
            SECTIONS[stage].model_validate(values)
        except KeyError:
            complaints.add("--stage-settings", stage, expected=f"one of {', '.join(SECTIONS)}", found="no such stage")
        except ValidationError as error:
            for problem in error.errors(include_url=False):
                key = ".".join(map(str, (stage, *problem["loc"])))
                complaints.add("--stage-settings", key, expected=problem["msg"], found=repr(problem["input"]))
    complaints.raise_if_any()
    return given


def prepare(dial: Dial, subject: Subject, folder: Path) -> list[Job]:
    """The dial's jobs, after one run of its reference that does not count.

    It is the output to compare with where the truth is not known, and it warms up what only a first run has to do: file
    caches, compiled kernels.

    Raises:
        InputError: if the stage fails.
    """
    values = list(dial.values(subject))
    log.info("%s: %s, a first run that does not count", dial.name, label(values[-1]))
    reference = {**dial.fixed, dial.setting: values[-1]}
    for command in [dial.stage.command(subject, folder, reference), *dial.stage.later_commands(subject, folder)]:
        run_measured(command).require_success()
    truth = dial.stage.truth(subject)
    against = "truth" if truth else "reference"
    tolerances = {f"{metric.name} ({against})": metric.tolerance(subject) for metric in dial.stage.metrics}

    def cost(setting: str) -> Cost:
        return Cost(dial.name, setting, tolerances, dial.stage.unit)

    expected = truth or dial.stage.written(folder)
    jobs = [Job(dial, value, expected, cost(label(value))) for value in values]
    return [Job(dial, None, None, cost(IMPORTS_ONLY)), *jobs]


def measure(job: Job, subject: Subject, out: Path) -> MeasuredRun:
    """Run one job into the empty folder `out`, add to its cost, and empty the folder.

    A setting with which the stage refuses to work is a result, too: it costs time and has no error.

    Raises:
        InputError: if the stage breaks.
    """
    stage, cost, only_imports = job.dial.stage, job.cost, job.expected is None
    change = {**job.dial.fixed, job.dial.setting: job.value}
    done = run_measured(stage.imports() if only_imports else stage.command(subject, out, change))
    cost.seconds.append(done.seconds)
    cost.cpu_seconds.append(done.cpu_seconds)
    cost.peak_mb.append(done.peak_mb)
    if not done.refused:
        done.require_success()
    judged_before = bool(stage.afterwards and cost.errors)  # later stages give the same again, and take minutes
    if not (done.refused or only_imports or judged_before):
        for command in stage.later_commands(subject, out):
            run_measured(command).require_success()
        output = stage.written(out)
        cost.work = stage.work(output)
        for name, metric in zip(cost.tolerances, stage.metrics, strict=True):
            cost.errors.setdefault(name, []).append(metric.error(subject, output, job.expected))
    shutil.rmtree(out, ignore_errors=True)
    return done


def label(value: Any) -> str:
    """A setting's value as the table names it."""
    return "all" if value is None else str(value)


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
