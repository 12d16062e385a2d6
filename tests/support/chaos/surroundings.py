"""Bad surroundings: too little disk, memory or file handles, strange paths and environments, two runs at once."""

from __future__ import annotations

import os
import random
import resource
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import psutil

from tests.support.chaos import forked_stage
from tests.support.chaos.captures import short
from tests.support.chaos.forked_stage import Ended
from tests.support.chaos.kills import LEFT_OUT, judged, reference, run, shorter
from tests.support.chaos.outcome import Attack, Outcome, Result
from tests.support.chaos.sound_run import RESULTS, SoundRun, digests

FOLDERS = ("with a space", "ünïcode 写真", 'quote\'s "two"', "-rf", "{x}", "$(id) *", "a" * 200)

QUICK = ("index_capture", "calibrate_color", "book_patterns", "track_mesh")
"""Stages that see every kind of path and environment."""

NOBODY = 65534


def attacks(sound: SoundRun, seed: int, count: int) -> list[Attack]:
    """Every condition for the stages that it touches, in an order that is drawn."""
    drawn = [Attack(name, partial(attack, sound)) for name, attack in _all([step.stage for step in sound.steps])]
    random.Random(seed).shuffle(drawn)
    return drawn[:count]


def _all(stages: list[str]) -> Iterator[tuple[str, Callable[[SoundRun, Path], Result]]]:
    for stage in (stage for stage in stages if stage not in LEFT_OUT):
        for bytes_ in (9_000, 40_000):
            yield f"{stage}, no file above {bytes_} bytes", partial(scarce, stage, partial(limit, "FSIZE", bytes_))
        for handles in (3, 8, 20):
            yield f"{stage}, {handles} more file handles", partial(scarce, stage, partial(limit_handles, handles))
        for more in (8, 64, 200):
            yield f"{stage}, {more} MiB of memory", partial(scarce, stage, partial(limit_memory, more))
        for free in (0, 12, 100):
            yield f"{stage}, {free} KiB of disk left", partial(full_disk, stage, free)
        yield f"{stage}, twice at once", partial(at_once, stage)
        yield f"{stage}, umask 077", partial(unchanged, stage, partial(os.umask, 0o077))
    for stage in QUICK:
        for folder in FOLDERS:
            yield f"{stage}, in a folder called {folder[:20]}", partial(elsewhere, stage, folder)
        for name, change in {
            "no HOME": {"HOME": None}, "a HOME that is not there": {"HOME": "/nowhere"},
            "the C locale": {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
            "a Turkish locale": {"LC_ALL": "tr_TR.UTF-8"}, "no PATH": {"PATH": None},
            "warnings": {"PYTHONWARNINGS": "default"}, "a far time zone": {"TZ": "Pacific/Kiritimati"},
        }.items():  # fmt: skip
            yield f"{stage}, {name}", partial(environment, stage, change)
    for stage in ("index_capture", "calibrate_color"):
        yield f"{stage}, results that cannot be written", partial(read_only, stage)


def scarce(stage: str, before: Callable[[], None], sound: SoundRun, folder: Path) -> Result:
    """A stage that lacks something says so, leaves nothing, and works when it is there again."""
    sound.before(stage, folder)
    return _then_again(run(sound.step(stage), folder, before), stage, sound, folder)


def _then_again(ended: Ended, stage: str, sound: SoundRun, folder: Path) -> Result:
    """The class of a refusal: that of the same command without the lack, unless it was itself a defect."""
    if ended.hung:
        return Result(Outcome.HANG, stage, short(ended.printed))
    if ended.defect:
        return Result(Outcome.TRACEBACK, stage, short(ended.printed))
    if ended.code == 0:
        return judged(ended, stage, reference(sound, stage).files, folder)
    again = judged(run(sound.step(stage), folder), stage, reference(sound, stage).files, folder)
    clear = again.outcome is Outcome.RIGHT and "error: " in ended.printed
    return Result(Outcome.CLEAR, stage, short(ended.printed)) if clear else again


def limit(name: str, value: int) -> None:
    resource.setrlimit(getattr(resource, f"RLIMIT_{name}"), (value, value))


def limit_handles(more: int) -> None:
    """Leave a few handles above those that are open: Python itself needs one to start a module."""
    limit("NOFILE", max(int(name) for name in os.listdir("/proc/self/fd")) + more)


def limit_memory(more_mib: int) -> None:
    limit("AS", psutil.Process().memory_info().vms + (more_mib << 20))


def full_disk(stage: str, free_kib: int, sound: SoundRun, folder: Path) -> Result:
    """A disk for the results on which little is left."""
    inputs = sound.before(stage, folder / "inputs")
    (folder / "captures").symlink_to(inputs / "captures")
    disk = folder / "results"
    disk.mkdir()
    used = sum(
        path.stat().st_blocks // 2 + 8 for path in inputs.rglob("*") if path.is_file() and "results" in path.parts
    )
    mounted = ["mount", "-t", "tmpfs", "-o", f"size={used + free_kib + 64}k", "none", str(disk)]
    if subprocess.run(mounted, capture_output=True).returncode:
        return Result(Outcome.RIGHT, stage, "not tried: no file system can be mounted here")
    try:
        if (inputs / RESULTS).is_dir():
            shutil.copytree(inputs / RESULTS, folder / RESULTS)
        left = shutil.disk_usage(disk).free - (free_kib << 10)
        (disk / "filled").write_bytes(bytes(max(left, 0)))
        ended = run(sound.step(stage), folder)
        (disk / "filled").unlink()
        subprocess.run(["mount", "-o", "remount,size=1g", str(disk)], check=True)
        return _then_again(ended, stage, sound, folder)
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def at_once(stage: str, sound: SoundRun, folder: Path) -> Result:
    """Of two that write the same, one does, and the other says so or comes after it."""
    sound.before(stage, folder)
    log = folder / f".{stage}.log"
    first = forked_stage.start(stage, shorter(sound.step(stage)), folder)
    kept = log.rename(folder / ".first.log")
    second = forked_stage.start(stage, shorter(sound.step(stage)), folder)
    two = second.ended()
    one = forked_stage.Started(first.pid, kept).ended()
    for ended in (one, two):
        if ended.defect or ended.hung:
            return Result(Outcome.TRACEBACK, stage, short(ended.printed))
    refused = [ended for ended in (one, two) if ended.code]
    if len(refused) == 2:
        return Result(Outcome.LOST, stage, f"neither ended well: {short(one.printed)} | {short(two.printed)}")
    found = judged(one if not one.code else two, stage, reference(sound, stage).files, folder)
    if found.outcome is not Outcome.RIGHT or not refused:
        return found
    return Result(Outcome.CLEAR, stage, short(refused[0].printed))


def unchanged(stage: str, before: Callable[[], object], sound: SoundRun, folder: Path) -> Result:
    """What should change nothing."""
    sound.before(stage, folder)
    ended = run(sound.step(stage), folder, before)
    return _right(ended, stage, sound, folder)


def _right(ended: Ended, stage: str, sound: SoundRun, folder: Path) -> Result:
    if ended.defect:
        return Result(Outcome.TRACEBACK, stage, short(ended.printed))
    return judged(ended, stage, reference(sound, stage).files, folder)


def elsewhere(stage: str, name: str, sound: SoundRun, folder: Path) -> Result:
    """The project in a folder of a strange name."""
    inside = folder / name
    inside.mkdir()
    sound.before(stage, inside)
    return _right(run(sound.step(stage), inside), stage, sound, inside)


def environment(stage: str, change: dict[str, str | None], sound: SoundRun, folder: Path) -> Result:
    """Other variables, which Python reads when it starts: a process of its own."""
    sound.before(stage, folder)
    wanted = {name: value for name, value in {**os.environ, **change}.items() if value is not None}
    command = [sys.executable, "-m", f"pipeline.stages.{stage}", *shorter(sound.step(stage))]
    wanted["PYTHONPATH"] = str(Path(__file__).resolve().parents[3])
    done = subprocess.run(command, cwd=folder, env=wanted, capture_output=True, text=True, errors="replace")
    return _right(Ended(done.returncode, done.stdout + done.stderr), stage, sound, folder)


def read_only(stage: str, sound: SoundRun, folder: Path) -> Result:
    """A user who may read everything and write nothing."""
    sound.before(stage, folder)
    os.chmod(folder, 0o755)
    files = digests(folder)

    def become_nobody() -> None:
        os.setgid(NOBODY)
        os.setuid(NOBODY)

    ended = run(sound.step(stage), folder, become_nobody if os.getuid() == 0 else None)
    if os.getuid() or ended.defect or ended.code == 0 or digests(folder) != files:
        outcome = Outcome.RIGHT if os.getuid() else Outcome.TRACEBACK if ended.defect else Outcome.LOST
        return Result(outcome, stage, short(ended.printed))
    return Result(Outcome.CLEAR, stage, short(ended.printed))
