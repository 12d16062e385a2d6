"""Kills: stages at each of their writes, and Snakemake with and without its jobs; then the same command again."""

from __future__ import annotations

import os
import random
import signal
import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from functools import cache, partial
from itertools import islice
from pathlib import Path

import psutil

from tests.support.chaos import forked_stage
from tests.support.chaos.captures import short
from tests.support.chaos.outcome import Attack, Outcome, Result
from tests.support.chaos.sound_run import CAPTURE, RESULTS, SoundRun, Step, copy_linked, differences, digests
from tests.support.workflow.stage_server import StageServer

SHORTER = {"train_avatar": {"--steps": "9", "--checkpoint-every": "3", "--log-every": "3"}}
"""Flags of stages that would take minutes."""

LEFT_OUT = ("synthesize_capture", "evaluate_avatar")
"""Stages that are not killed: one makes the capture itself, one reads an avatar that is not trained here."""

SNAKEMAKES = 10
"""Kills of whole workflows: each takes as long as ten of a stage."""

KILLED_WITHIN_S = 8.0
"""Seconds in which a workflow up to the tracking is at work; it is killed at a time drawn from them."""


def attacks(sound: SoundRun, seed: int, count: int) -> list[Attack]:
    """Draw places in each stage, from a fresh folder and from one with the stage's results."""
    rng = random.Random(seed)
    kinds = []
    for stage in (step.stage for step in sound.steps if step.stage not in LEFT_OUT):
        places = list(range(1, reference(sound, stage).changes + 1))
        rng.shuffle(places)
        kinds.append([(stage, place, again) for place in places for again in (False, True)])
    drawn = (kind[turn] for turn in range(max(map(len, kinds))) for kind in kinds if turn < len(kind))
    snakemakes = [
        Attack(f"workflow killed, {whom}, number {number}", partial(kill_workflow, sound, whom, rng.random()))
        for number in range(SNAKEMAKES // 2)
        for whom in ("Snakemake alone", "all of it")
    ]
    stages = [
        Attack(
            f"{stage} killed before change {place} of files, {'over its results' if again else 'fresh'}",
            partial(kill_stage, sound, stage, place, again),
        )
        for stage, place, again in islice(drawn, max(count - len(snakemakes), 0))
    ]
    return [*stages, *snakemakes][:count]


@dataclass(frozen=True)
class Reference:
    """What a stage does when nobody kills it: number of changes of files, and digests of all files afterwards."""

    changes: int
    files: dict[str, str]


@cache
def reference(sound: SoundRun, stage: str) -> Reference:
    """Run a stage once from its inputs; its results are kept beside the sound run."""
    folder = sound.folder.parent / f"reference_{stage}"
    counted = folder / "changes"
    if not counted.is_file():
        sound.before(stage, folder)

        def count(number: int) -> None:
            with open(counted, "w") as file:
                file.write(str(number))

        ended = run(sound.step(stage), folder, forked_stage.count_changes(folder / "results", count))
        assert ended.code == 0, ended.printed
    return Reference(int(counted.read_text()), digests(folder))


def run(step: Step, folder: Path, before: Callable[[], None] | None = None) -> forked_stage.Ended:
    """Run a job with its shorter settings."""
    return forked_stage.run(step.stage, shorter(step), folder, before)


def shorter(step: Step) -> list[str]:
    """Words of a job with its shorter settings."""
    words = list(step.words)
    for flag, value in SHORTER.get(step.stage, {}).items():
        words[words.index(flag) + 1] = value
    return words


def kill_stage(sound: SoundRun, stage: str, place: int, again: bool, folder: Path) -> Result:
    """Kill a stage before a change of files, look at what it left, and run it again."""
    step, expected = sound.step(stage), reference(sound, stage)
    sound.before(stage, folder)
    if again:
        copy_linked_over(sound.folder.parent / f"reference_{stage}", folder)
    run(step, folder, forked_stage.killed_at(folder / "results", place))
    half = [
        name for name, digest in digests(folder).items() if name in expected.files and digest != expected.files[name]
    ]
    if half:
        return Result(Outcome.DIFFERING, stage, f"after the kill: {', '.join(half)[:300]}")
    return judged(run(step, folder), stage, expected.files, folder)


def copy_linked_over(source: Path, folder: Path) -> None:
    """Put the results of a finished stage over those that it started from."""
    for path in sorted((source / RESULTS).rglob("*")):
        into = folder / path.relative_to(source)
        if path.is_file() and not into.exists():
            into.parent.mkdir(parents=True, exist_ok=True)
            os.link(path, into)


def judged(
    ended: forked_stage.Ended,
    stage: str,
    expected: dict[str, str],
    folder: Path,
    below: Collection[str] = (CAPTURE, RESULTS),
) -> Result:
    """The class of the second command, by the files below some folders."""
    if ended.hung:
        return Result(Outcome.HANG, stage, short(ended.printed))
    if ended.code:
        lost = Outcome.TRACEBACK if ended.defect else Outcome.LOST
        return Result(lost, stage, f"the same command again: {short(ended.printed)}")
    if other := differences(expected, digests(folder, below)):
        return Result(Outcome.DIFFERING, stage, "; ".join(other)[:400])
    return Result(Outcome.RIGHT, stage)


def kill_workflow(sound: SoundRun, whom: str, share: float, folder: Path) -> Result:
    """Kill a workflow up to the tracking and run it again; what it had locked is free by itself."""
    target = f"{RESULTS}/tracking/0000.safetensors"
    for name in ("Snakefile", "workflow", "profiles", "envs", "pipeline"):
        (folder / name).symlink_to(sound.folder / name)
    (folder / "config").symlink_to(sound.folder / "config")
    copy_linked(sound.folder / CAPTURE, folder / CAPTURE)
    with StageServer() as stages:
        start = partial(forked_stage.start_snakemake, folder=folder, python=str(stages.python))
        started = start(["--", target])
        time.sleep(share * KILLED_WITHIN_S)
        shells, below = psutil.Process(started.pid).children(recursive=True), psutil.Process(stages.pid).children()
        for process in (psutil.Process(started.pid), *((*shells, *below) if whom == "all of it" else ())):
            _kill(process)
        started.ended()
        psutil.wait_procs(shells)  # Of one that has just begun, the stage is yet to come.
        wait_for_orphans(psutil.Process(stages.pid))
        ended = start(["--", target]).ended()
    known = digests(sound.folder)
    written = {name for step in _up_to(sound, "track_mesh") for name in step.writes}
    found = digests(folder)
    expected = {name: known[name] for name in known if name in written or name.startswith("captures/") or name in found}
    return judged(ended, "workflow", expected, folder)


def _up_to(sound: SoundRun, stage: str) -> Iterator[Step]:
    """Steps that the tracking needs; others of the sound run may have been made before it or after."""
    aside = ("synthesize_capture", "calibrate_color", "unwrap_atlas", "plan_effects")
    for step in sound.steps:
        if step.stage not in aside:
            yield step
        if step.stage == stage:
            return


def wait_for_orphans(server: psutil.Process) -> None:
    """Wait for stages whose workflow is gone; they hold the locks of their outputs."""
    while any(child.status() != psutil.STATUS_ZOMBIE for child in server.children()):
        time.sleep(0.05)


def _kill(process: psutil.Process) -> None:
    try:
        process.send_signal(signal.SIGKILL)
    except psutil.NoSuchProcess:
        return
