"""The same bytes twice: clean runs of tiny agree in every file that is no time or measurement."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from tests.support.chaos import forked_stage
from tests.support.chaos.kills import judged
from tests.support.chaos.outcome import Attack, Result
from tests.support.chaos.sound_run import TARGET, SoundRun, digests
from tests.support.workflow.project_copy import COPIED

ALLOWED_S = 3000.0


def attacks(sound: SoundRun, seed: int, count: int) -> list[Attack]:
    """Runs on one core and on two, beside the sound run, which was on two."""
    return [Attack(f"tiny on {cores} cores, from nothing", partial(again, sound, cores)) for cores in (1, 2)][:count]


def again(sound: SoundRun, cores: int, folder: Path) -> Result:
    """Run the workflow from nothing and compare all files with the sound run's."""
    for name in ("Snakefile", *COPIED, "pipeline"):
        (folder / name).symlink_to(sound.folder / name)
    ended = forked_stage.start_snakemake(["--cores", str(cores), "--", TARGET], folder).ended(ALLOWED_S)
    return judged(ended, "workflow", digests(sound.folder), folder)
