"""Writes the presets draft, standard and reference from the committed curves.

    python -m pipeline.budget.presets

The rule, for each curve of `pipeline.budget.curves`, by the metric that decides:

- standard: the fastest setting whose error is at most what is allowed, which nobody minds or which is a tenth above the
  smallest error that was measured, on every subject; of settings about as fast, the most accurate;
- draft: the same with an error at most DRAFT_TIMES as large;
- reference: of the settings that are as good as the default on every subject, that whose largest error is smallest, of
  several the fastest; the default, where it lies beyond what was measured.

A test keeps the files in step with the curves.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import Any

import yaml

from pipeline import STAGES
from pipeline.base.code_digest import ROOT
from pipeline.budget.curve import Curve
from pipeline.budget.curves import FOLDER, Measured, read_curves, read_measured
from pipeline.budget.subject_curve import SubjectCurve, parse_setting, setting_name
from pipeline.config.project import SECTIONS

DRAFT_TIMES = 10.0
"""Errors of a draft over those that nobody minds: 1 dB of a picture, a tenth of full scale of irradiance."""

RULES = {
    "draft": f"for each dial the fastest setting with at most {DRAFT_TIMES:g} times the error that is allowed, on "
    "every subject",
    "standard": "for each dial the fastest setting with at most the error that is allowed, on every subject",
    "reference": "for each dial the setting with the smallest error, of those that are as good as the default on every "
    "subject",
}
WIDTH = 116


def choose(preset: str, curve: Curve) -> Any:
    """The value that a preset takes from a curve."""
    if preset == "reference":
        return _most_accurate(curve)
    name = curve.cheapest(DRAFT_TIMES if preset == "draft" else 1.0)
    # Where nothing is as good as is allowed, the best there is.
    return _most_accurate(curve) if name is None else parse_setting(name)


def _most_accurate(curve: Curve) -> Any:
    values = [parse_setting(name) for name in curve.settings]
    good = [value for value in values if all(as_good(part, value, curve.default) for part in curve.parts)]
    return min(good, key=lambda value: (max(curve.losses(value)), curve.factor(value)), default=curve.default)


def as_good(curve: SubjectCurve, value: Any, other: Any) -> bool:
    """True if a value loses no more than another one, but for the standard error of both.

    False if the other one lies beyond what was measured.
    """
    lost = curve.error(value) - curve.error(other)
    scatter = math.hypot(curve.scatter(value), curve.scatter(other))
    return lost <= scatter


def preset_yaml(preset: str, curves: Sequence[Curve], measured: Sequence[Measured]) -> str:
    """A preset's file: the rule and the numbers as a comment, and the settings, in data order."""
    sections: dict[str, dict[str, Any]] = {}
    lines = []
    for curve in sorted(curves, key=lambda curve: STAGES.index(curve.stage)):
        value = choose(preset, curve)
        # As the settings have it: a number of samples is text, which `full` is, too.
        settings = SECTIONS[curve.stage].model_validate({curve.option: value})
        sections.setdefault(curve.stage, {})[curve.option] = settings.model_dump(mode="json")[curve.option]
        lines.append(f"{curve.stage}.{curve.option} {setting_name(value)}: {_numbers(curve, value)}; {curve.metric}")
    subjects = ", ".join(
        f"{one.subject} ({one.kind}, {one.cameras} cameras, {one.frames} frames, {one.pixels} pixels an image)"
        for one in measured
    )
    text = (
        f"Preset {preset}, written by `make presets`: {RULES[preset]}. Measured on {subjects}; errors stand with what "
        f"is allowed; see config/curves. `--configfile config/presets/{preset}.yaml`"
    )
    indented = [textwrap.wrap(line, WIDTH, subsequent_indent="    ") for line in lines]
    comment = [*textwrap.wrap(text, WIDTH), *(f"  {part}" for line in indented for part in line)]
    return "".join(f"# {line}\n" for line in comment) + yaml.safe_dump(sections, sort_keys=False)


def _numbers(curve: Curve, value: Any) -> str:
    """Errors, what is allowed, and time, in words."""
    known = [f"{part.subject} {part.error(value):.3g} ({part.allowed:.3g})" for part in curve.parts]
    if any(math.isnan(part.error(value)) for part in curve.parts):
        return "the default, beyond what was measured"
    return f"errors {', '.join(known)}, {curve.factor(value):.2f} of the default's time"


def main() -> None:
    """Write the three files."""
    curves, measured = read_curves(ROOT / FOLDER / "accuracy_cost.csv"), read_measured(ROOT / FOLDER / "subjects.yaml")
    for preset in RULES:
        (ROOT / f"config/presets/{preset}.yaml").write_text(preset_yaml(preset, curves, measured))


if __name__ == "__main__":
    main()
