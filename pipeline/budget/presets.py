"""Writes the presets draft, standard and reference from the committed curves.

    python -m pipeline.budget.presets

The rule, for each curve of `pipeline.budget.curves`, by the metric that decides:

- standard: the fastest setting whose error is at most what is allowed, which nobody minds or which is a tenth above the
  smallest error that was measured; of settings about as fast, the most accurate;
- draft: the same with an error at most DRAFT_TIMES as large;
- reference: the setting with the smallest error, of several the fastest.

A test keeps the files in step with the curves.
"""

from __future__ import annotations

import textwrap
from typing import Any

import yaml

from pipeline.base.code_digest import ROOT
from pipeline.budget.curves import FOLDER, Curve, Measured, parse_setting, read_curves, read_measured
from pipeline.config.project import SECTIONS

DRAFT_TIMES = 10.0
"""Errors of a draft over those that nobody minds: 1 dB of a picture, a tenth of full scale of irradiance."""

RULES = {
    "draft": f"for each dial the fastest setting with at most {DRAFT_TIMES:g} times the error that is allowed",
    "standard": "for each dial the fastest setting with at most the error that is allowed",
    "reference": "for each dial the setting with the smallest error, of several the fastest",
}
WIDTH = 116


def choose(preset: str, curve: Curve) -> int:
    """Place of the setting that a preset takes from a curve."""
    if preset == "reference":
        return min(range(len(curve.settings)), key=lambda place: (curve.errors[place], curve.seconds[place]))
    place = curve.cheapest(curve.allowed * (DRAFT_TIMES if preset == "draft" else 1.0))
    # Where nothing is as good as is allowed, the best there is.
    return choose("reference", curve) if place is None else place


def preset_yaml(preset: str, curves: list[Curve], measured: Measured) -> str:
    """A preset's file: the rule and the numbers as a comment, and the settings."""
    sections: dict[str, dict[str, Any]] = {}
    lines = []
    for curve in curves:
        place = choose(preset, curve)
        name = curve.settings[place]
        # As the settings have it: a number of samples is text, which `full` is, too.
        settings = SECTIONS[curve.stage].model_validate({curve.option: parse_setting(name)})
        sections.setdefault(curve.stage, {})[curve.option] = settings.model_dump(mode="json")[curve.option]
        numbers = f"error {curve.errors[place]:.3g} (allowed {curve.allowed:.3g}), {curve.seconds[place]:.1f} s"
        lines.append(f"{curve.stage}.{curve.option} {name}: {numbers}; {curve.metric}")
    text = (
        f"Preset {preset}, written by `make presets`: {RULES[preset]}. Measured on {measured.subject} "
        f"({measured.cameras} cameras, {measured.frames} frames, {measured.pixels} pixels an image), with seconds of "
        f"one processor; see config/curves. `--configfile config/presets/{preset}.yaml`"
    )
    indented = [textwrap.wrap(line, WIDTH, subsequent_indent="    ") for line in lines]
    comment = [*textwrap.wrap(text, WIDTH), *(f"  {part}" for line in indented for part in line)]
    return "".join(f"# {line}\n" for line in comment) + yaml.safe_dump(sections, sort_keys=False)


def main() -> None:
    """Write the three files."""
    curves, measured = read_curves(ROOT / FOLDER / "accuracy_cost.csv"), read_measured(ROOT / FOLDER / "subject.yaml")
    for preset in RULES:
        (ROOT / f"config/presets/{preset}.yaml").write_text(preset_yaml(preset, curves, measured))


if __name__ == "__main__":
    main()
