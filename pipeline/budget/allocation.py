"""Settings for a time budget, from the committed curves.

`pipeline.budget.knapsack` makes the choice.

A stage is expected to take what jobs of its size took (`pipeline.budget.run_seconds`), with as many steps and texels as
asked for, times a factor for each other dial: its time at the setting over that at the default, the mean over the
curves' subjects (`pipeline.budget.dial_times`). How much the effects of a plan cost is left out. Errors are expected as
on subjects of the same kind (`pipeline.budget.dial_errors`).

The budget only chooses what neither the subject's file nor the command line says.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pipeline.base.errors import InputError
from pipeline.budget.capture_size import CaptureSize
from pipeline.budget.curve import Curve
from pipeline.budget.curves import Measured
from pipeline.budget.dial_errors import DialErrors
from pipeline.budget.dial_times import DialTimes, spent_in, with_options
from pipeline.budget.estimate import Choice, Estimate
from pipeline.budget.knapsack import Combination, Option, best_within
from pipeline.budget.run_seconds import StageSeconds
from pipeline.budget.subject_curve import SubjectCurve, parse_setting, setting_name
from pipeline.budget.total_loss import is_psnr_loss, total_loss_db
from pipeline.config.project import SubjectSettings
from pipeline.metrics.cost import pareto_front

BEYOND_LOSS = 1e-6
"""What a default that lies beyond the measured settings is taken to lose less than the best of them, over what is
allowed: as good as nothing, but enough for it to be chosen where there is time."""

OVERRULED_BY = {("unwrap_atlas", "texel_pixels"): "size"}
"""Settings that have no say once another one of the same stage has."""


def within_budget(
    subject: str, settings: SubjectSettings, said: Mapping[str, Any], size: CaptureSize, curves: Sequence[Curve],
    measured: Sequence[Measured], pace: float | Mapping[str, float] = 1.0,
) -> tuple[SubjectSettings, Estimate]:  # fmt: skip
    """The settings with what the budget chooses, and what to expect of them.

    Args:
        settings: with `budget_minutes`.
        said: what the user says, which stays.
        size: of this capture.
        measured: the subjects of the curves.
        pace: seconds that jobs take here over those that are expected, of all stages or by stage.

    Raises:
        InputError: if no setting is fast enough, with what takes the time and what the user has set.
    """
    budget_s = 60.0 * settings.budget_minutes
    usual = at_defaults(settings, curves)
    times, errors = DialTimes.of(usual, size, curves), DialErrors.of(settings, size, measured)
    paces = {stage: pace.get(stage, 1.0) if isinstance(pace, Mapping) else pace for stage in times.usual}
    turned = [curve for curve in curves if spent_in(curve) in times.usual]
    base = {stage: each.times(paces[stage]) for stage, each in times.usual.items()}
    fixed = {curve.dial: _setting(settings, curve) for curve in turned if _is_said(said, settings, curve)}
    dials: dict[str, dict[str, list[Option]]] = {}
    for curve in turned:
        dials.setdefault(spent_in(curve), {})[curve.dial] = _options(curve, errors, fixed, times, paces)
    overhead = sum(seconds.fixed for seconds in base.values())
    best, fastest = best_within(budget_s - overhead, {stage: each.work for stage, each in base.items()}, dials)
    if best is None:
        raise InputError(_refusal(subject, settings, fixed, turned, fastest, base))
    names = dict(best.names)
    changes: dict[str, dict[str, Any]] = {}
    for curve in turned:
        if curve.dial not in fixed:
            changes.setdefault(curve.stage, {})[curve.option] = parse_setting(names[curve.dial])
    choices = [_choice(curve, errors, names[curve.dial], fixed, times) for curve in turned]
    factors, more = dict.fromkeys(base, 1.0), dict.fromkeys(base, 0.0)
    for curve, choice in zip(turned, choices, strict=True):
        factors[spent_in(curve)] *= choice.factor
        for stage, each in times.elsewhere(curve, parse_setting(choice.setting)).items():
            more[stage] += paces[stage] * each
    seconds = {stage: each.fixed + each.work * factors[stage] + more[stage] for stage, each in base.items()}
    psnr_db = next((_expected_psnr(turned, choices, one) for one in measured if one.subject == subject), math.nan)
    names_of = ", ".join(one.subject for one in measured)
    return with_options(settings, changes), Estimate(subject, names_of, budget_s, seconds, choices, psnr_db, paces)


def at_defaults(settings: SubjectSettings, curves: Sequence[Curve]) -> SubjectSettings:
    """The settings with all dials at their defaults."""
    changes: dict[str, dict[str, Any]] = {}
    for curve in curves:
        changes.setdefault(curve.stage, {})[curve.option] = curve.default
    return with_options(settings, changes)


def _is_said(said: Mapping[str, Any], settings: SubjectSettings, curve: Curve) -> bool:
    """True if the user says the setting, or one that overrules it."""
    overruled = OVERRULED_BY.get((curve.stage, curve.option))
    if overruled is not None and getattr(getattr(settings, curve.stage), overruled) is not None:
        return True
    section = said.get(curve.stage)
    return isinstance(section, Mapping) and curve.option in section


def _setting(settings: SubjectSettings, curve: Curve) -> Any:
    return getattr(getattr(settings, curve.stage), curve.option)


def _options(
    curve: Curve, errors: DialErrors, fixed: Mapping[str, Any], times: DialTimes, paces: Mapping[str, float]
) -> list[Option]:
    """The Pareto front of a curve, and all of one that costs other stages time; a setting of the user's alone.

    A default beyond the settings that were measured is one more, and best.
    """
    values = [fixed[curve.dial]] if curve.dial in fixed else [parse_setting(name) for name in curve.settings]
    options = []
    for value in values:
        elsewhere = math.fsum(paces[stage] * each for stage, each in times.elsewhere(curve, value).items())
        options.append(Option(setting_name(value), times.factor(curve, value), errors.loss(curve, value), elsewhere))
    if curve.dial in fixed:
        return options
    kept = options
    if not any(option.elsewhere for option in options):
        front = pareto_front(np.array([each.factor for each in options]), np.array([each.loss for each in options]))
        kept = [option for option, good in zip(options, front, strict=True) if good]
    if math.isnan(errors.error(curve, curve.default)):
        least = min(option.loss for option in options)
        kept.append(Option(setting_name(curve.default), 1.0, least - BEYOND_LOSS))
    return kept


def _choice(curve: Curve, errors: DialErrors, name: str, fixed: Mapping[str, Any], times: DialTimes) -> Choice:
    value = fixed[curve.dial] if curve.dial in fixed else parse_setting(name)
    by = "user" if curve.dial in fixed else "budget"
    return Choice(
        curve.dial, curve.stage, curve.option, name, by, errors.metric(curve), errors.error(curve, value),
        errors.allowed(curve), times.factor(curve, value),
    )  # fmt: skip


def _expected_psnr(turned: Sequence[Curve], choices: Sequence[Choice], measured: Measured) -> float:
    """What a subject of the curves had, less what the settings lose against those that it had."""
    now, then = [], []
    for curve, choice in zip(turned, choices, strict=True):
        own = curve.of(measured.subject)
        if own is not None and is_psnr_loss(curve.metric) and curve.dial in measured.settings:
            now.append(_error(own, parse_setting(choice.setting)))
            then.append(_error(own, measured.settings[curve.dial]))
    return measured.psnr_db + total_loss_db(then) - total_loss_db(now)


def _error(curve: SubjectCurve, value: Any) -> float:
    """Error at a setting; beyond those that were measured the smallest one."""
    error = curve.error(value)
    return min(curve.errors) if math.isnan(error) else error


def _refusal(
    subject: str, settings: SubjectSettings, fixed: Mapping[str, Any], turned: Sequence[Curve], fastest: Combination,
    base: Mapping[str, StageSeconds],
) -> str:  # fmt: skip
    least = (fastest.seconds + sum(each.fixed for each in base.values())) / 60
    seconds = {stage: each.fixed + each.work for stage, each in base.items()}
    largest = sorted(seconds, key=lambda stage: -seconds[stage])[:3]
    takes = ", ".join(f"{stage} {seconds[stage] / 60:.2g}" for stage in largest)
    held = [
        f"{curve.stage}.{curve.option} {setting_name(fixed[curve.dial])}" for curve in turned if curve.dial in fixed
    ]
    hint = f"; these settings are yours and stay: {', '.join(held)}" if held else ""
    return (
        f"{subject}: budget_minutes: expected at least {least:.3g} minutes of one processor, found "
        f"{settings.budget_minutes:g}; ask for more{hint}. Longest at ordinary settings, in minutes: {takes}"
    )
