"""The same bytes twice: clean runs of a subject agree in every file that is no time or measurement."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from tests.support.chaos import forked_stage
from tests.support.chaos.captures import short
from tests.support.chaos.kills import judged
from tests.support.chaos.outcome import Attack, Outcome, Result
from tests.support.chaos.sound_run import SUBJECT, SoundRun, digests
from tests.support.workflow.project_copy import COPIED

ALLOWED_S = 3000.0


def attacks(sound: SoundRun, seed: int, count: int, subject: str = SUBJECT) -> list[Attack]:
    """Runs of a subject from nothing, beside a first, which is on two cores.

    The first of the smallest subject is the sound run; that of another is made beside it, and kept.
    """
    runs = [
        Attack(f"{subject} on {cores} cores, from nothing", partial(again, sound, subject, cores))
        for cores in ((1, 2) if subject == SUBJECT else (1,))
    ]
    return runs[:count]


def again(sound: SoundRun, subject: str, cores: int, folder: Path) -> Result:
    """Run the workflow from nothing and compare all files with the first run's."""
    first = sound.folder
    if subject != SUBJECT:
        first = sound.folder.parent / f"first_{subject}"
        made = ran(sound, subject, 2, first)
        if made.code or made.hung:
            return Result(Outcome.HANG if made.hung else Outcome.LOST, "workflow", f"first run: {short(made.printed)}")
    ended, below = ran(sound, subject, cores, folder), (f"captures/{subject}", f"results/{subject}")
    return judged(ended, "workflow", digests(first, below), folder, below)


def ran(sound: SoundRun, subject: str, cores: int, folder: Path) -> forked_stage.Ended:
    """Run the workflow for a subject in a folder, with the code and configuration of the sound run."""
    folder.mkdir(exist_ok=True)
    for name in ("Snakefile", *COPIED, "pipeline"):
        if not (folder / name).exists():
            (folder / name).symlink_to(sound.folder / name)
    target = f"results/{subject}/metrics.csv"
    return forked_stage.start_snakemake(["--cores", str(cores), "--", target], folder).ended(ALLOWED_S)
