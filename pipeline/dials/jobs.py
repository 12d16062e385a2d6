"""Runs that measure dials, and how they are judged.

There is one run for each setting, for all dials that ask for it.
"""

from __future__ import annotations

import hashlib
import logging
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pipeline.dials.dial import CostedStage, Dial, Files, label
from pipeline.dials.subject import Subject
from pipeline.metrics.cost import IMPORTS_ONLY, Cost
from pipeline.metrics.measured_run import run_measured

log = logging.getLogger("measure_cost")


@dataclass(frozen=True)
class Expected:
    """Files that a stage's outputs are compared with: the truth, or what was kept."""

    stage: CostedStage
    truth: Files | None
    kept: Path

    def files(self, turn: int) -> Files:
        """Of the run of that number."""
        return self.truth or self.stage.written(kept_in(self.stage, self.kept, turn))


def kept_in(stage: CostedStage, folder: Path, turn: int) -> Path:
    """Folder in which the output of a run stays: one for each seed of what draws by one."""
    return folder / str(turn) if stage.seeded else folder


@dataclass(frozen=True)
class Job:
    """One setting of a stage, for all dials that ask for it.

    Attributes:
        stage: it runs.
        change: of its settings; None: the stage is only imported.
        costs: what it costs, dial by dial, and what its output is compared with.
        keep: where the output of its first run, or of each seed, stays, because others are compared with it.
    """

    stage: CostedStage
    change: Mapping[str, Any] | None
    costs: list[tuple[Cost, Expected | None]]
    keep: Path | None = None

    def commands(self, subject: Subject, out: Path, turn: int = 0) -> list[tuple[list[str], bool]]:
        """Command lines in order, and whether their time counts, of the run of that number."""
        if self.change is None:
            return [(command, True) for command in self.stage.imports()]
        later = self.stage.later_commands(subject, out, turn).items()
        turned = (self.stage.command(subject, out, self.change, turn), True)
        return [turned, *((command, name in self.stage.timed) for name, command in later)]

    def key(self, subject: Subject) -> str:
        """The same for jobs that do the same."""
        text = repr((self.stage.name, self.stage.metrics, self.commands(subject, Path("out"))))
        return hashlib.blake2b(text.encode(), digest_size=8).hexdigest()


def prepare(dial: Dial, subject: Subject, folder: Path) -> list[Job]:
    """The dial's jobs, after a first run that does not count.

    It warms up what only a first run has to do: file caches, compiled kernels. It also gives the output to compare with
    where the truth is not known; but of a stage that runs for minutes it is short, and the first run that counts does.

    Raises:
        InputError: if the stage fails.
    """
    stage, values = dial.stage, list(dial.values(subject))
    for name in [name for name in stage.makes if not (subject.made / name).exists()]:
        subject.made.mkdir(exist_ok=True)
        stage.makes[name](subject.made / name)
    log.info("%s: %s, a first run that does not count", dial.name, label(values[-1]))
    last = Job(stage, dial.change(values[-1]), [])
    if stage.warm_up is None:
        first = last if dial.reference is None else Job(stage, {**dial.fixed, **dial.reference}, [])
        commands, kept = [command for command, _ in first.commands(subject, folder)], folder
    else:
        commands = [stage.command(subject, folder, {**(last.change or {}), **stage.warm_up})]
        kept = subject.made / f"kept_{last.key(subject)}"
    for command in commands:
        run_measured(command).require_success()
    truth = stage.truth(subject)
    against = "truth" if truth else dial.against(subject)
    tolerances = {f"{metric.name} ({against})": metric.tolerance(subject) for metric in stage.metrics}
    jobs = [Job(stage, None, [(Cost(dial.name, IMPORTS_ONLY, tolerances, stage.unit, stage.name, dial.setting), None)])]
    for value in values:
        cost = Cost(dial.name, label(value), tolerances, stage.unit, stage.name, dial.setting)
        jobs.append(Job(stage, dial.change(value), [(cost, Expected(stage, truth, kept))]))
    if stage.warm_up is not None and not truth:
        jobs[-1] = replace(jobs[-1], keep=kept)
    return jobs


def merged(jobs: Sequence[Job], subject: Subject) -> list[Job]:
    """Jobs that do the same as one job; those first whose output others are compared with."""
    found: dict[str, Job] = {}
    for job in jobs:
        same = found.setdefault(job.key(subject), replace(job, costs=[]))
        same.costs.extend(job.costs)
        found[job.key(subject)] = replace(same, keep=same.keep or job.keep)
    return sorted(found.values(), key=lambda job: job.keep is None)


def measure(job: Job, subject: Subject, scratch: Path, turn: int = 0) -> str:
    """Run one job, add to what it costs, and say what that was. It writes to the empty folder `scratch`, which is empty
    again afterwards, or to its own.

    A setting with which the stage refuses to work is a result, too: it costs time and has no error.

    Args:
        turn: number of the run, which seeds what is drawn.

    Raises:
        InputError: if the stage breaks.
    """
    kept = kept_in(job.stage, job.keep, turn) if job.keep else None
    out = kept if kept and not kept.exists() else scratch
    commands = job.commands(subject, out, turn)
    judged = not job.stage.seeded and (all(cost.errors for cost, _ in job.costs) or bool(job.keep))
    if judged and job.stage.afterwards and out == scratch:  # what later stages judge by is the same again
        commands = commands[: 1 + max(place for place, (_, timed) in enumerate(commands) if timed)]
    done = [run_measured(command) for command, _ in commands[:1]]
    refused = done[0].refused and not job.keep
    if not refused:
        done[0].require_success()
        done += [run_measured(command).require_success() for command, _ in commands[1:]]
    timed = [one for one, (_, counts) in zip(done, commands, strict=False) if counts]
    seconds, peak_mb = sum(one.seconds for one in timed), max(one.peak_mb for one in timed)
    for cost, _ in job.costs:
        cost.seconds.append(seconds)
        cost.cpu_seconds.append(sum(one.cpu_seconds for one in timed))
        cost.peak_mb.append(peak_mb)
    if not (refused or job.change is None or job.keep or (judged and job.stage.afterwards)):
        judge(job, subject, job.stage.written(out), turn)
    if out == scratch:
        shutil.rmtree(out, ignore_errors=True)
    said = f", refused: {done[0].last_lines.splitlines()[-1]}" if refused else ""
    return f"{seconds:.2f} s, {peak_mb:.0f} MB{said}"


def judge(job: Job, subject: Subject, output: Files, turn: int = 0) -> None:
    """Add the errors of an output."""
    for cost, compared in job.costs:
        expected = compared.files(turn) if compared else {}
        cost.work = job.stage.work(output)
        for name, metric in zip(cost.tolerances, job.stage.metrics, strict=True):
            cost.errors.setdefault(name, []).append(metric.error(subject, output, expected))
            if metric.scatter is not None:
                cost.scatters.setdefault(name, []).append(metric.scatter(subject, output, expected))
