"""Bad settings and flags: keys and values of every setting, YAML's oddities, and the words of each stage."""

from __future__ import annotations

import inspect
import json
import random
import sys
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import jsonschema
import yaml

from pipeline import STAGES
from pipeline.config.project import SECTIONS
from tests.support.chaos import forked_stage
from tests.support.chaos.captures import short
from tests.support.chaos.mutations import descriptions
from tests.support.chaos.mutations.mutation import Meaning
from tests.support.chaos.outcome import Attack, Outcome, Result
from tests.support.chaos.sound_run import SoundRun, Step

OF_NO_SUBJECT = {"compare_subjects"}
"""Sections that the file of a subject may not have."""

SCHEMA = Path("workflow/schemas/config.schema.json")

VALUES: tuple[Any, ...] = (
    None, True, -1, 0, 1.5, 10**30, -1e308, 1e308, float("nan"), float("inf"), "", " ", "none", "auto", "-1", "1e5",
    "0x10", "١٢", "a b", "--help", "$(id)", "{x}", "../..", "x" * 5000, "é", [], [1, 2, 3], ["a"], [[1]], {}, {"a": 1},
    "2026-01-01",
)  # fmt: skip
"""Values that are tried for every setting; the schema says which of them are wrong."""

WORDS = (
    "",
    "-1",
    "0",
    "1.5",
    "1e999",
    "nan",
    "inf",
    "1_000",
    "none",
    "auto",
    "--help",
    "٣",
    "a b",
    "x" * 3000,
    "true",
    "[1]",
    "{}",
)
"""Words that are tried after every flag."""

PLACES = (
    "",
    "nowhere",
    "/dev/null",
    "/dev/zero",
    "/proc/self/mem",
    ".",
    "file.txt/below",
    "x" * 300,
    "a\nb",
    "loop",
    "empty.json",
)
"""Paths that are tried in place of every file that a stage reads."""

OUTPUTS = ("", "file.txt", "file.txt/below", "theirs", "/proc/nowhere", "x" * 300, "loop")
"""Paths that are tried in place of every output: none can be written, or belongs to somebody."""


def attacks(sound: SoundRun, seed: int, count: int) -> list[Attack]:
    """Draw an equal share of settings in files, on the command line, in variants, of flags, and of paths."""
    rng = random.Random(seed)
    kinds = [list(kind) for kind in (_texts(), _settings(), _flags(), _paths(sound.steps))]
    for kind in kinds:
        rng.shuffle(kind)
    drawn = (kind[turn] for turn in range(max(map(len, kinds))) for kind in kinds if turn < len(kind))
    return [Attack(name, partial(run, sound)) for name, run in islice(drawn, count)]


def _texts() -> Iterator[tuple[str, Any]]:
    """The subject's file, as text."""
    for what, (meaning, change) in descriptions.TEXTS.items():
        yield f"subject's file: {what}", partial(_plan_text, change, meaning is Meaning.BROKEN)


def _settings() -> Iterator[tuple[str, Any]]:
    """Every setting with every value, by one of the ways to say it."""
    ways, number = (_plan_file, _plan_command_line, _plan_variant), 0
    for section, model in SECTIONS.items():
        for key in (*model.model_fields, "nonsense"):
            for value in VALUES:
                way = ways[number % (3 if section == "train_avatar" else 2)]
                number += 1
                yield f"{way.__name__[6:]}: {section}.{key}: {_shown(value)}", partial(way, section, key, value)


def _flags() -> Iterator[tuple[str, Any]]:
    """Every flag of every stage with every word."""
    for stage in STAGES:
        settings = SECTIONS[stage].model_fields
        for flag in (*settings, "nonsense"):
            for word in WORDS:
                yield f"{stage} --{flag.replace('_', '-')} {_shown(word)}", partial(_flag, stage, flag, word)


def _paths(steps: tuple[Step, ...]) -> Iterator[tuple[str, Any]]:
    """Every path that a job of the sound run is given, in place of it another."""
    for step in steps:
        for place, word in enumerate(step.words):
            if word.startswith("--") and word.lstrip("-") in ("out", *_inputs(step.stage)):
                paths = OUTPUTS if word == "--out" else PLACES
                yield from (
                    (f"{step.stage} {word} {_shown(path)}", partial(_path, step, place + 1, path)) for path in paths
                )


def _inputs(stage: str) -> list[str]:
    """Flags of a stage that are paths."""
    parameters = inspect.signature(sys.modules[f"pipeline.stages.{stage}"].run).parameters
    return [name.replace("_", "-") for name, one in parameters.items() if "Path" in str(one.annotation)]


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) < 30 else f"{text[:10]}... of {len(text)} letters"


def is_wrong(section: str, key: str, value: Any) -> bool:
    """True if the published schema refuses a value, and also what the value says if it is text of a number."""
    schema = json.loads(SCHEMA.read_text())
    validator = jsonschema.Draft202012Validator({**schema, "required": []})
    readings = [value]
    if isinstance(value, str):
        with suppress(yaml.YAMLError, ValueError):
            readings.append(yaml.safe_load(value))
        with suppress(ValueError):
            readings.append(float(value))
            readings.append(int(value))
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        readings.append(str(value))  # A number where text is due is its text.
    if isinstance(value, bool):
        readings.append("on" if value else "off")  # As YAML reads these words.
    if isinstance(value, list):
        readings.append([str(item) for item in value])
    return not any(validator.is_valid({section: {key: reading}}) for reading in readings)


def _plan_text(change: Any, wrong: bool, sound: SoundRun, folder: Path) -> Result:
    content = change((sound.folder / "config/subjects/tiny.yaml").read_text())
    return _planned(sound, folder, content, wrong, "tiny")


def _plan_file(section: str, key: str, value: Any, sound: SoundRun, folder: Path) -> Result:
    content = yaml.safe_load((sound.folder / "config/subjects/tiny.yaml").read_text())
    content[section] = {**content.get(section, {}), key: value}
    wrong, named = is_wrong(section, key, value), key
    if section in OF_NO_SUBJECT:
        wrong, named = True, section
    return _planned(sound, folder, yaml.safe_dump(content, allow_unicode=True), wrong, named)


def _plan_variant(section: str, key: str, value: Any, sound: SoundRun, folder: Path) -> Result:
    content = yaml.safe_load((sound.folder / "config/subjects/tiny.yaml").read_text())
    content["variants"] = {"full": {key: value}}
    return _planned(sound, folder, yaml.safe_dump(content, allow_unicode=True), is_wrong(section, key, value), key)


def _plan_command_line(section: str, key: str, value: Any, sound: SoundRun, folder: Path) -> Result:
    said = yaml.safe_dump({key: value}, default_flow_style=True, width=10**6, allow_unicode=True).strip()
    content = (sound.folder / "config/subjects/tiny.yaml").read_text()
    return _planned(sound, folder, content, is_wrong(section, key, value), key, "--config", f"{section}={said}")


def _planned(sound: SoundRun, folder: Path, content: str | bytes, wrong: bool, named: str, *options: str) -> Result:
    """A dry run with a subject's file and options."""
    for name in ("Snakefile", "workflow", "profiles", "envs", "pipeline"):
        (folder / name).symlink_to(sound.folder / name)
    (folder / "config/subjects").mkdir(parents=True)
    for name in ("config.yaml", "presets", "curves"):
        (folder / "config" / name).symlink_to(sound.folder / "config" / name)
    (folder / "config/subjects/tiny.yaml").write_bytes(content if isinstance(content, bytes) else content.encode())
    ended = forked_stage.start_snakemake(["--dry-run", *options, "--", "results/tiny/metrics.csv"], folder).ended()
    return _judged(ended, "workflow", wrong, named)


def _judged(ended: forked_stage.Ended, stage: str, wrong: bool, named: str) -> Result:
    """The class of an ended command. A refusal is clear if it names what is wrong."""
    said = short(ended.printed[max(ended.printed.rfind("WorkflowError"), 0) :])
    if ended.hung:
        return Result(Outcome.HANG, stage, said)
    if ended.defect:
        return Result(Outcome.TRACEBACK, stage, said)
    names = named in ended.printed or named.replace("_", "-") in ended.printed
    if ended.code and (names or ended.code == 2):  # 2: a command line that is not understood, which shows it
        return Result(Outcome.CLEAR, stage, said)
    return Result(Outcome.NONSENSE if wrong else Outcome.RIGHT, stage, said)


def _flag(stage: str, flag: str, word: str, sound: SoundRun, folder: Path) -> Result:
    """The stage without any of its files: where the flag is accepted, it says that these are missing.

    The one that reads none finds somebody else's in its output folder, and says that.
    """
    words = []
    if stage == "synthesize_capture":
        (folder / "nowhere/out").mkdir(parents=True)
        (folder / "nowhere/out/recording.exr").touch()
    for name, parameter in inspect.signature(sys.modules[f"pipeline.stages.{stage}"].run).parameters.items():
        if parameter.default is parameter.empty:
            number = str(parameter.annotation) == "int"
            words += [f"--{name.replace('_', '-')}", "0" if number else f"nowhere/{name}"]
    kind = SECTIONS[stage].model_fields.get(flag)
    wrong = kind is None or (is_wrong(stage, flag, word) and is_wrong(stage, flag, [word]))
    given = [f"--{flag.replace('_', '-')}", word]
    if kind is not None and kind.annotation is bool:
        wrong, given = True, [f"--{flag.replace('_', '-')}={word}"]
    ended = forked_stage.run(stage, [*words, *given], folder)
    if word == "--help" and ended.code == 0 and "usage" in ended.printed:
        return Result(Outcome.RIGHT, stage, "help")
    return _judged(ended, stage, wrong, flag)


def _path(step: Step, place: int, path: str, sound: SoundRun, folder: Path) -> Result:
    """A job of the sound run with one other path. What stands there of somebody else is there afterwards."""
    sound.before(step.stage, folder)
    (folder / "file.txt").write_text("kept")
    (folder / "empty.json").write_text("")
    (folder / "theirs").mkdir()
    (folder / "theirs/recording.exr").write_text("kept")
    (folder / "loop").symlink_to("loop")
    words = [*step.words]
    words[place] = path
    ended = forked_stage.run(step.stage, words, folder)
    kept = [file for file in ("file.txt", "theirs/recording.exr") if (folder / file).is_file()]
    if [(folder / file).read_text() for file in kept] != ["kept", "kept"]:
        return Result(Outcome.LOST, step.stage, f"{words[place - 1]} {path}: what was there is gone")
    # A stage may add files beside others, and read nothing of what it is given.
    return (
        _judged(ended, step.stage, False, "error")
        if ended.code
        else Result(Outcome.RIGHT, step.stage, short(ended.printed))
    )
