"""Bad captures: mutated copies of tiny, indexed, and as far as they are accepted taken through later stages."""

from __future__ import annotations

import random
import re
from collections.abc import Iterator
from functools import partial
from itertools import islice, pairwise
from pathlib import Path

import pandas as pd
import yaml

from pipeline.base.files import digest_file
from tests.support.chaos import answers, forked_stage
from tests.support.chaos.mutations import (
    any_files,
    csv_files,
    descriptions,
    image_files,
    keypoint_tables,
    names,
    templates,
)
from tests.support.chaos.mutations.mutation import Meaning, Mutation
from tests.support.chaos.outcome import Attack, Outcome, Result
from tests.support.chaos.sound_run import CAPTURE, SoundRun, Step, copy_linked, copy_outputs

LAST = "pack_shards"
"""The last stage that an accepted capture is taken to; from there on, it is numbers that were checked."""

WEAK = re.compile(r"(\S+: [^:\n]+: (?:weak|failed)): .*$", re.MULTILINE)
"""A verdict as it is logged: stage, what it is on, and its grade; then the reason."""

SHORT = 400
"""Letters of a message that are kept."""


def attacks(sound: SoundRun, seed: int, count: int) -> list[Attack]:
    """Draw mutations, an equal share of each kind of file.

    Args:
        sound: the run of the capture that is mutated.
        seed: of all that is drawn.
        count: how many.
    """
    kinds = list(kinds_of(sound.folder / CAPTURE, seed))
    for kind in kinds:
        random.Random(seed).shuffle(kind)
    drawn = _in_turn(kinds, {})
    return [Attack(mutation.name, partial(attack, sound, mutation)) for mutation in islice(drawn, count)]


def _in_turn(kinds: list[list[Mutation]], seen: dict[str, int]) -> Iterator[Mutation]:
    """One of each kind, again and again, until all are through; each name once."""
    for turn in range(max(map(len, kinds))):
        for kind in kinds:
            if turn < len(kind) and kind[turn].name not in seen:
                seen[kind[turn].name] = turn
                yield kind[turn]


def kinds_of(root: Path, seed: int) -> Iterator[list[Mutation]]:
    """Mutations of each kind of file."""
    rng = random.Random(seed)
    yield list(descriptions.mutations(yaml.safe_load((root / "capture.yaml").read_text()), rng))
    files = [str(path.relative_to(root)) for path in sorted(root.rglob("*")) if path.is_file()]
    files = [name for name in files if not name.startswith(("truth/", "."))]
    tables = [name for name in files if name.endswith(".csv")]
    for name in tables:
        yield list(csv_files.mutations(name, root, rng))
    yield list(keypoint_tables.mutations(rng))
    yield list(templates.mutations(root, rng))
    cameras, lights = (pd.read_csv(root / f"{kind}s.csv")[kind] for kind in ("camera", "light"))
    yield list(names.mutations([str(name) for name in cameras], [str(name) for name in lights]))
    images: dict[str, list[str]] = {}
    for name in files:
        if name.endswith((".exr", ".png", ".jpg")):
            kind = re.match(r"(images|masks|calibration/\w+)/", name)[1]
            images.setdefault(kind, []).append(name)
    for kind, of_kind in images.items():
        yield [*image_files.of_one(rng.choice(of_kind), rng), *image_files.of_one(rng.choice(of_kind), rng)]
        yield [*image_files.of_many(kind, of_kind), *_of_cameras(kind, of_kind, list(cameras))]
    others = ["keypoints_2d.parquet", "template/template.glb", "capture.yaml", *tables]
    others += [rng.choice(of_kind) for of_kind in images.values()]
    yield [mutation for name in others for mutation in any_files.mutations(name, rng)]


def _of_cameras(kind: str, files: list[str], cameras: list[str]) -> Iterator[Mutation]:
    """Two cameras' images exchanged; all changes to those of one camera."""
    for first, second in pairwise(cameras):
        if all(any(f"/{name}/" in file for file in files) for name in (first, second)):
            yield image_files.exchanged(kind, first, second, files)
    for camera in cameras[:2]:
        own = [file for file in files if f"/{camera}/" in file]
        if own:
            yield from image_files.of_many(f"{kind} of {camera}", own)


def attack(sound: SoundRun, mutation: Mutation, folder: Path) -> Result:
    """Mutate, index, and run what follows until a stage refuses or `LAST` is done."""
    copy_linked(sound.folder / CAPTURE, folder / CAPTURE)
    mutation.apply(folder / CAPTURE)
    warned = ""
    for number, step in enumerate(following(sound)):
        if number and _reads_the_same(sound.folder, folder, step):
            copy_outputs(sound.folder, folder, step)
            continue
        ended = forked_stage.run(step.stage, step.words, folder)
        if ended.hung:
            return Result(Outcome.HANG, step.stage, short(ended.printed))
        if ended.defect:
            return Result(Outcome.TRACEBACK, step.stage, short(ended.printed))
        if ended.code:
            return Result(Outcome.LATE if number else Outcome.CLEAR, step.stage, short(ended.printed))
        warned += new_warnings(ended.printed, sound.folder / f"results/tiny/logs/{step.stage}.log", mutation.renamed)
    return judged(sound, mutation, folder, warned)


def following(sound: SoundRun) -> Iterator[Step]:
    """The steps from index_capture to `LAST`."""
    names = [step.stage for step in sound.steps]
    yield from sound.steps[names.index("index_capture") : names.index(LAST) + 1]


def _reads_the_same(sound: Path, folder: Path, step: Step) -> bool:
    """True if all files that a step reads are those of the sound run: then it writes the same, too.

    The index has the digests of all that it names, so files of the capture need no look.
    """
    for name in step.reads:
        ours, theirs = folder / name, sound / name
        if name.startswith("captures/") or theirs.is_dir():
            continue
        if not ours.is_file() or not theirs.is_file() or digest_file(ours) != digest_file(theirs):
            return False
    return True


def judged(sound: SoundRun, mutation: Mutation, folder: Path, warned: str) -> Result:
    """The class of a capture that no stage refused."""
    found = answers.departures(answers.read(sound.folder), answers.read(folder, mutation.renamed), sound.folder)
    said = "; ".join(found)
    if not found:
        return Result(Outcome.RIGHT, LAST)
    if mutation.meaning is Meaning.OTHER:
        return Result(Outcome.UNTOLD, LAST, said)
    if warned:
        return Result(Outcome.JUDGED, LAST, f"{said} | {short(warned)}")
    return Result(Outcome.NONSENSE, LAST, said)


def new_warnings(printed: str, sound_log: Path, renamed: tuple[str, str] | None = None) -> str:
    """Weak and failed verdicts, by what they are on, that the sound run does not have."""
    known = {found[1] for found in WEAK.finditer(sound_log.read_text())} if sound_log.is_file() else set()
    if renamed:
        known |= {line.replace(f" {renamed[0]}:", f" {renamed[1]}:") for line in known}
    return "\n".join(found[0] for found in WEAK.finditer(printed) if found[1] not in known)


def short(text: str) -> str:
    """The end of what was printed, on one line."""
    error = text.rfind("error: ")
    lines = text[error if error >= 0 else max(0, len(text) - SHORT) :].split()
    return " ".join(lines)[:SHORT]
