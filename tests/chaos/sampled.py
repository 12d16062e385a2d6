"""A few attacks of each kind on the smallest capture, up to its index: what `test_chaos.py` runs.

    python -m tests.chaos.sampled FOLDER

A process of its own, that forks before libraries start threads: children that are forked later may wait for these.
"""

from __future__ import annotations

import importlib
import random
import shutil
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from pipeline.base.errors import InputError
from tests.support.captures.builder import build_capture
from tests.support.chaos import forked_stage, kills, records
from tests.support.chaos.captures import kinds_of, short
from tests.support.chaos.mutations.mutation import Mutation
from tests.support.chaos.outcome import Attack, Outcome, Result
from tests.support.chaos.sound_run import CAPTURE, RESULTS, SoundRun, Step, copy_linked
from tests.support.chaos.surroundings import limit, limit_handles, scarce

STAGE = "index_capture"
INDEX = Step(STAGE, ("--capture", CAPTURE, "--out", f"{RESULTS}/index"), (), ())
SEED, KILLS, MUTATIONS = 20, 4, 40


def main() -> None:
    """Command line."""
    folder = Path(sys.argv[1])
    importlib.import_module(f"pipeline.stages.{STAGE}")
    build_capture(folder / "sound" / CAPTURE, measured=True)
    sound = SoundRun(folder / "sound", (INDEX,))
    for part, attack in _all(sound):
        place, began = folder / "attack", time.monotonic()
        place.mkdir()
        records.append(folder / "attacks.csv", part, attack.name, attack.run(place), time.monotonic() - began)
        shutil.rmtree(place)


def _all(sound: SoundRun) -> Iterator[tuple[str, Attack]]:
    for place in random.Random(SEED).sample(range(1, kills.reference(sound, STAGE).changes + 1), KILLS):
        again = bool(place % 2)
        yield "kills", Attack(f"before change {place}", partial(kills.kill_stage, sound, STAGE, place, again))
    for name, before in (("small files", partial(limit, "FSIZE", 4500)), ("few handles", partial(limit_handles, 3))):
        yield "surroundings", Attack(name, partial(scarce, STAGE, before, sound))
    yield "harness", Attack("another file", partial(_spoilt, sound))
    yield "harness", Attack("a death", partial(_ended_badly, "import os; os.abort()"))
    yield "harness", Attack("a stand-still", partial(_ended_badly, "import time; time.sleep(60)"))
    mutations = [mutation for kind in kinds_of(sound.folder / CAPTURE, SEED) for mutation in kind]
    for mutation in random.Random(SEED).sample(mutations, MUTATIONS):
        yield f"captures, {mutation.meaning}", Attack(mutation.name, partial(_indexed, sound, mutation))


def _indexed(sound: SoundRun, mutation: Mutation, folder: Path) -> Result:
    """The class of a capture that is indexed within this process, which is the quickest."""
    from pipeline.capture.index.validation import index_folder

    copy_linked(sound.folder / CAPTURE, folder / CAPTURE)
    mutation.apply(folder / CAPTURE)
    try:
        index_folder(folder / CAPTURE, threads=1)
    except InputError as error:
        return Result(Outcome.CLEAR, STAGE, short(f"error: {error}"))
    except Exception as error:
        return Result(Outcome.TRACEBACK, STAGE, f"{type(error).__name__}: {error}")
    return Result(Outcome.RIGHT, STAGE)


def _spoilt(sound: SoundRun, folder: Path) -> Result:
    """A stage that leaves a file behind."""
    sound.before(STAGE, folder)
    ended = kills.run(INDEX, folder, partial((folder / CAPTURE / "left_over").write_text, ""))
    return kills.judged(ended, STAGE, kills.reference(sound, STAGE).files, folder)


def _ended_badly(code: str, folder: Path) -> Result:
    """A stage that dies, or stands still."""
    ended = forked_stage.run(STAGE, ["--help"], folder, partial(exec, code), allowed_s=0.3)
    return Result(Outcome.HANG if ended.hung else Outcome.TRACEBACK if ended.defect else Outcome.RIGHT)


if __name__ == "__main__":
    main()
