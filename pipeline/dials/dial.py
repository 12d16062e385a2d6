"""Dial: one setting of one stage, the values it takes, and how the output is judged.

A stage is run as its users run it, from the command line, with what the workflow left in a subject's results folder;
stages never import stages.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pipeline.base.errors import Complaints
from pipeline.dials.subject import Subject

Files = Mapping[str, Path]
"""Where a stage's output is, by what it is called in `CostedStage.outputs`."""


@dataclass(frozen=True)
class Metric:
    """An error of a stage's output.

    Attributes:
        name: what is measured, how it is averaged, and its unit.
        error: of (subject, output, expected output).
        tolerance: the error that nobody minds, for a subject.
        scatter: of the same, the error's standard error over frames; None: it is no mean over frames.
    """

    name: str
    error: Callable[[Subject, Files, Files], float]
    tolerance: Callable[[Subject], float]
    scatter: Callable[[Subject, Files, Files], float] | None = None


@dataclass(frozen=True)
class CostedStage:
    """Stage whose settings are turned: how it is run and judged.

    Attributes:
        name: of the module in `pipeline.stages`.
        inputs: files below the subject's results without which it does not run.
        outputs: what is judged: name -> (path below {out}, path below the capture's truth); None where there is none.
        metrics: the first one decides.
        files: those of `pipeline.config.stage_commands` that are elsewhere than in the subject's results, of this stage
            and of `afterwards`: name -> path, with {out} and {made} filled in; None leaves the flag out.
        unit, work: what the stage counts, and how often, read from its output.
        runs_on: whether a subject calls for the stage at all.
        afterwards: later stages, run once per setting if the metrics judge what they make of the output; their time
            does not count.
        timed: those of them whose time does count, for a setting that costs time later: they run every time.
        heads_only: those of them that run for a subject with mean textures alone.
        settings: what differs from the subject's settings in every run, for runs that are shorter than the subject's.
        later_settings: what differs from the subject's settings in `afterwards`.
        warm_up: for a stage that runs for minutes, settings with which a run that does not count is short.
        seeded: the one of these stages that draws by its setting `seed`, which then counts the runs; the reference is
            the run of the same seed. None: nothing is drawn, and one output is judged.
        makes: files that are no subject's: name below {made} -> what writes it.
    """

    name: str
    inputs: tuple[str, ...]
    outputs: Mapping[str, tuple[str | None, str | None]]
    metrics: tuple[Metric, ...]
    unit: str
    work: Callable[[Files], float | int]
    files: Mapping[str, str | None] = field(default_factory=dict)
    runs_on: Callable[[Subject], bool] = lambda subject: True
    afterwards: tuple[str, ...] = ()
    timed: tuple[str, ...] = ()
    heads_only: tuple[str, ...] = ("bake_textures",)
    settings: Mapping[str, Any] = field(default_factory=dict)
    later_settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    warm_up: Mapping[str, Any] | None = None
    seeded: str | None = None
    makes: Mapping[str, Callable[[Path], None]] = field(default_factory=dict)

    def command(self, subject: Subject, out: Path, change: Mapping[str, Any], turn: int = 0) -> list[str]:
        """Command line with the subject's settings but for `change`, in a run of that number."""
        return self._command_line(self.name, subject, out, {**self.settings, **change, **self._seed(self.name, turn)})

    def _seed(self, stage: str, turn: int) -> dict[str, int]:
        return {"seed": turn} if turn and stage == self.seeded else {}

    def later_commands(self, subject: Subject, out: Path, turn: int = 0) -> dict[str, list[str]]:
        """The command lines of `afterwards`, in order, by stage."""
        return {
            name: self._command_line(
                name, subject, out, {**self.later_settings.get(name, {}), **self._seed(name, turn)}
            )
            for name in self.afterwards
            if subject.has("head") or name not in self.heads_only
        }

    def _command_line(self, stage: str, subject: Subject, out: Path, change: Mapping[str, Any]) -> list[str]:
        places = {"out": out, "made": subject.made}
        own = {name: path.format(**places) if path else () for name, path in self.files.items()}
        return subject.command_line(stage, change, own)

    def imports(self) -> list[list[str]]:
        """Command lines that do nothing but import the stages whose time counts."""
        return [[sys.executable, "-c", f"import pipeline.stages.{name}"] for name in (self.name, *self.timed)]

    def written(self, out: Path) -> Files:
        """Files of the stage's output in folder `out`."""
        return {name: out / path for name, (path, _) in self.outputs.items() if path}

    def truth(self, subject: Subject) -> Files | None:
        """True output, if the capture knows all of it that the metrics compare."""
        known = {name: subject.capture / "truth" / path for name, (_, path) in self.outputs.items() if path}
        return known if known and all(path.is_file() for path in known.values()) else None

    def lacking(self, subject: Subject) -> list[str]:
        """Files that it would read and that are not there."""
        names = [name.format(variant=subject.variant) for name in self.inputs]
        return [name for name in names if not (subject.results / name).exists()]


@dataclass(frozen=True)
class Dial:
    """A setting that trades accuracy for time.

    Attributes:
        name: on the command line and in the table.
        stage: whose setting it is.
        setting: its name in the stage's settings.
        values: for a subject, the last one being the reference; None reads `all` in the table.
        fixed: other settings of the stage that hold for all values.
        reference: settings of the stage that give the reference, if that is none of the values.
        chosen: whether presets and budgets choose the setting: it means the same on any capture, and no other dial has
            it. See `pipeline.budget.curves`.
    """

    name: str
    stage: CostedStage
    setting: str
    values: Callable[[Subject], Sequence[Any]]
    fixed: Mapping[str, Any] = field(default_factory=dict)
    reference: Mapping[str, Any] | None = None
    chosen: bool = False

    def change(self, value: Any) -> dict[str, Any]:
        """Settings of the stage that differ from the subject's where the dial is at `value`."""
        return {**self.fixed, self.setting: value}

    def against(self, subject: Subject) -> str:
        """Reference of the errors where the truth is not known, in words.

        For example `reference 8, steps 200`.
        """
        last = label(list(self.values(subject))[-1])
        words = last if self.reference is None else " ".join(f"{key} {value}" for key, value in self.reference.items())
        given = self.reference or {}
        fixed = {key: value for key, value in self.fixed.items() if key not in given}
        rest = [fixed, *(part for name, part in self.stage.later_settings.items() if name != "evaluate_avatar")]
        return ", ".join([f"reference {words}", *(f"{key} {value}" for part in rest for key, value in part.items())])


def label(value: Any) -> str:
    """A setting's value as the table names it."""
    return "all" if value is None else str(value)


def possible_dials(dials: Sequence[Dial], wanted: Sequence[str], subject: Subject) -> tuple[list[Dial], list[str]]:
    """Dials to turn, and for each of the others why not.

    Raises:
        InputError: if a wanted dial does not exist or cannot be turned on this subject, or if none can.
    """
    reasons = {dial.name: _obstacle(dial, subject) for dial in dials}
    complaints = Complaints(f"{subject.results}: dials")
    for name in wanted:
        if name not in reasons:
            complaints.add("dials", name, expected=f"one of {', '.join(reasons)}", found="no such dial")
        elif reasons[name]:
            complaints.messages.append(f"{name}: {reasons[name]}")
    possible = [dial for dial in dials if not reasons[dial.name] and (not wanted or dial.name in wanted)]
    if not possible and not complaints:
        complaints.messages += [f"{name}: {reason}" for name, reason in reasons.items()]
    complaints.raise_if_any()
    return possible, [f"{name}: {reason}" for name, reason in reasons.items() if reason]


def _obstacle(dial: Dial, subject: Subject) -> str:
    lacking = dial.stage.lacking(subject)
    if lacking:
        return f"expected {', '.join(lacking)} in {subject.results}, found no such file; run the workflow first"
    return "" if dial.stage.runs_on(subject) else f"{dial.stage.name} takes what it is given on this subject"
