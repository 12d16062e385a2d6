"""Settings for a time budget, from the committed curves.

`pipeline.budget.knapsack` makes the choice.

A stage is expected to take what it took on the curves' subject, without the import of its code, in proportion to what
it works through (`SCALES_WITH`), times a factor for each dial: its time at the setting over its time at that subject's
setting. That leaves out image size in training, how many lights are on, and other processors. An error is expected to
be that of the curves' subject at the same setting.

The budget only chooses what neither the subject's file nor the command line says.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from pipeline.base.errors import InputError
from pipeline.budget.capture_size import CaptureSize
from pipeline.budget.curves import Curve, Measured, parse_setting, setting_name
from pipeline.budget.estimate import Choice, Estimate
from pipeline.budget.knapsack import Combination, Option, best_within
from pipeline.config.project import SECTIONS, SubjectSettings
from pipeline.config.sections import merge

SCALES_WITH: dict[str, tuple[str, ...]] = {
    "index_capture": ("images",), "calibrate_cameras": ("cameras",), "calibrate_color": ("cameras",),
    "calibrate_lights": ("cameras",), "book_patterns": ("images",), "unwrap_atlas": (), "track_mesh": ("images",),
    "plan_effects": (), "trace_irradiance": ("frames",), "pack_shards": ("images", "pixels"),
    "train_avatar": ("variants",), "evaluate_avatar": ("images", "variants"),
}  # fmt: skip
"""The stages on the way to metrics.csv, and what their time is in proportion to."""

SPENT_IN = {"unwrap_atlas": "train_avatar"}
"""Where a setting of a stage costs time, if not there: texels are laid out once and trained in every step."""


def within_budget(
    subject: str, settings: SubjectSettings, said: Mapping[str, Any], size: CaptureSize, curves: Sequence[Curve],
    measured: Measured,
) -> tuple[SubjectSettings, Estimate]:  # fmt: skip
    """The settings with what the budget chooses, and what to expect of them.

    Args:
        settings: with `budget_minutes`.
        said: what the user says, which stays.
        size: of this capture.

    Raises:
        InputError: if no setting is fast enough, with what takes the time and what the user has set.
    """
    budget_s = 60.0 * settings.budget_minutes
    known = measured.seconds.keys() & SCALES_WITH.keys()
    turned = [curve for curve in curves if _spent_in(curve) in known and curve.dial in measured.settings]
    fixed = {curve.dial: _setting(settings, curve) for curve in turned if _is_said(said, curve)}
    base = {stage: _base_seconds(stage, size, measured, turned) for stage in SCALES_WITH if stage in measured.seconds}
    dials: dict[str, dict[str, list[Option]]] = {}
    for curve in turned:
        dials.setdefault(_spent_in(curve), {})[curve.dial] = _options(curve, measured, fixed)
    imports = sum(overhead for overhead, _ in base.values())
    best, fastest = best_within(budget_s - imports, {stage: work for stage, (_, work) in base.items()}, dials)
    if best is None:
        raise InputError(_refusal(subject, settings, fixed, turned, fastest, imports, base))
    names = dict(best.names)
    changes: dict[str, dict[str, Any]] = {}
    for curve in turned:
        if curve.dial not in fixed:
            changes.setdefault(curve.stage, {})[curve.option] = parse_setting(names[curve.dial])
    sections = {
        stage: SECTIONS[stage](**merge(getattr(settings, stage).model_dump(), options))
        for stage, options in changes.items()
    }
    choices = [_choice(curve, measured, names[curve.dial], fixed) for curve in turned]
    factors = dict.fromkeys(base, 1.0)
    for curve, choice in zip(turned, choices, strict=True):
        factors[_spent_in(curve)] *= choice.factor
    seconds = {stage: overhead + work * factors[stage] for stage, (overhead, work) in base.items()}
    psnr_db = _expected_psnr(turned, choices, measured) if subject == measured.subject else math.nan
    return settings.model_copy(update=sections), Estimate(
        subject, measured.subject, budget_s, seconds, choices, psnr_db
    )


def _spent_in(curve: Curve) -> str:
    return SPENT_IN.get(curve.stage, curve.stage)


def _is_said(said: Mapping[str, Any], curve: Curve) -> bool:
    section = said.get(curve.stage)
    return isinstance(section, Mapping) and curve.option in section


def _setting(settings: SubjectSettings, curve: Curve) -> Any:
    return getattr(getattr(settings, curve.stage), curve.option)


def _factor(curve: Curve, measured: Measured, value: Any) -> float:
    """Time at a setting over that at the setting of the curves' subject."""
    return curve.work(value) / curve.work(measured.settings[curve.dial])


def _loss(curve: Curve, value: Any) -> float:
    """Error in units of what is allowed; 0 if it is not known, as it cannot be chosen by."""
    error = curve.error(value)
    return 0.0 if math.isnan(error) else error / max(curve.allowed, 1e-12)


def _options(curve: Curve, measured: Measured, fixed: Mapping[str, Any]) -> list[Option]:
    """The Pareto front of a curve; of a dial that the user has set, that setting alone."""
    if curve.dial in fixed:
        value = fixed[curve.dial]
        return [Option(setting_name(value), _factor(curve, measured, value), _loss(curve, value))]
    values = [parse_setting(curve.settings[place]) for place in curve.front()]
    return [Option(setting_name(value), _factor(curve, measured, value), _loss(curve, value)) for value in values]


def _base_seconds(stage: str, size: CaptureSize, measured: Measured, turned: Sequence[Curve]) -> tuple[float, float]:
    """Seconds of importing a stage, and of its work at the settings of the curves' subject, here."""
    imports = min([curve.imports for curve in turned if curve.stage == stage == _spent_in(curve)], default=0.0)
    imports = min(imports, measured.seconds[stage])
    return imports, (measured.seconds[stage] - imports) * size.over(measured_size(measured), SCALES_WITH[stage])


def measured_size(measured: Measured) -> CaptureSize:
    """Size of the curves' subject."""
    return CaptureSize(measured.cameras, measured.frames, measured.pixels, 1)


def _choice(curve: Curve, measured: Measured, name: str, fixed: Mapping[str, Any]) -> Choice:
    value = fixed[curve.dial] if curve.dial in fixed else parse_setting(name)
    by = "user" if curve.dial in fixed else "budget"
    error, factor = curve.error(value), _factor(curve, measured, value)
    return Choice(curve.dial, curve.stage, curve.option, name, by, curve.metric, error, curve.allowed, factor)


def _expected_psnr(turned: Sequence[Curve], choices: Sequence[Choice], measured: Measured) -> float:
    """What the curves' subject had, less what the settings lose against those that it had, dial by dial."""
    lost = [
        choice.error - curve.error(measured.settings[curve.dial])
        for curve, choice in zip(turned, choices, strict=True)
        if curve.metric.startswith("PSNR")
    ]
    return measured.psnr_db - sum(lost)


def _refusal(
    subject: str, settings: SubjectSettings, fixed: Mapping[str, Any], turned: Sequence[Curve], fastest: Combination,
    imports: float, base: Mapping[str, tuple[float, float]],
) -> str:  # fmt: skip
    least = (fastest.seconds + imports) / 60
    largest = sorted(base, key=lambda stage: -sum(base[stage]))[:3]
    takes = ", ".join(f"{stage} {sum(base[stage]) / 60:.2g}" for stage in largest)
    held = [
        f"{curve.stage}.{curve.option} {setting_name(fixed[curve.dial])}" for curve in turned if curve.dial in fixed
    ]
    hint = f"; these settings are yours and stay: {', '.join(held)}" if held else ""
    return (
        f"{subject}: budget_minutes: expected at least {least:.3g} minutes of one processor, found "
        f"{settings.budget_minutes:g}; ask for more{hint}. Longest at ordinary settings, in minutes: {takes}"
    )
