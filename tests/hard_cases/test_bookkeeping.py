"""Logs and images that break the bookkeeping of patterns: finite numbers, no false alarm, and what is true is said."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from pipeline.sync.brightness import BrightnessModel
from pipeline.sync.subject_proxy import Ellipsoid, shading_response
from pipeline.sync.sync import IN_SYNC, UNDETERMINED, UNEXPLAINED, SyncCheck, check_sync
from tests.support.results.hard_case import HardCase
from tests.support.rigs.light_stage import (
    Stage,
    brightness_model,
    build_stage,
    one_at_a_time,
    photograph,
    random_groups,
    white,
)


@pytest.fixture(scope="module")
def stage() -> Stage:
    return build_stage(7, frames=24, cameras=5, lights=16)


def checked(model: BrightnessModel) -> SyncCheck:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = check_sync(model)
    numbers = found.frames[["predicted", "observed", "deviation"]].to_numpy()
    assert np.isfinite(numbers[found.frames.offset_frames == 0]).all()
    assert np.isfinite(found.powers.dead).all()
    assert np.isfinite(found.powers.stuck).all()
    assert np.isfinite(list(found.sigmas_ahead.values())).all()
    return found


def all_dark(stage: Stage, rng: np.random.Generator) -> np.ndarray:
    return white(np.zeros((stage.frames, len(stage.lights))))


def one_light_ever(stage: Stage, rng: np.random.Generator) -> np.ndarray:
    levels = np.zeros((stage.frames, len(stage.lights)))
    levels[:, 3] = 5
    return white(levels)


def first_half_dark(stage: Stage, rng: np.random.Generator) -> np.ndarray:
    levels = random_groups(stage, rng)
    levels[: stage.frames // 2] = 0
    return levels


def one_side(stage: Stage, rng: np.random.Generator) -> np.ndarray:
    levels = random_groups(stage, rng, every=99)
    levels[:, stage.lights[:, 0] < 0] = 0
    return levels


def red_only(stage: Stage, rng: np.random.Generator) -> np.ndarray:
    return random_groups(stage, rng) * np.array([1.0, 0, 0])


def tiny_units(stage: Stage, rng: np.random.Generator) -> np.ndarray:
    return 1e-6 * random_groups(stage, rng)


def huge_range(stage: Stage, rng: np.random.Generator) -> np.ndarray:
    levels = random_groups(stage, rng)
    levels[5] *= 1000
    return levels


HEALTHY: dict[str, Callable[[Stage, np.random.Generator], np.ndarray]] = {
    "never a light": all_dark,
    "one and the same light": one_light_ever,
    "first half dark": first_half_dark,
    "lights of one side only": one_side,
    "red light only": red_only,
    "one frame a thousand times brighter": huge_range,
    "every light once, and again": one_at_a_time,
}


@pytest.mark.parametrize("log_name", HEALTHY)
def test_a_healthy_log_raises_no_alarm(case: HardCase, stage: Stage, log_name: str) -> None:
    rng = np.random.default_rng(0)
    log = HEALTHY[log_name](stage, rng)
    found = checked(brightness_model(stage, log, photograph(stage, log, rng)))
    assert found.verdict in (IN_SYNC, UNDETERMINED), found.why
    case.check(len(found.faults), 0, unit="alarms")
    if log_name in ("never a light", "one and the same light"):
        # How well brightness follows the log, as a correlation: neither varies but by noise.
        seen = photograph(stage, log, rng).sum((1, 2))
        with np.errstate(invalid="ignore", divide="ignore"):
            case.naive_fails(np.corrcoef(log.sum((1, 2)), seen)[0, 1])


def test_black_images_of_a_lit_log_are_unexplained(stage: Stage) -> None:
    log = random_groups(stage, np.random.default_rng(0))
    found = checked(brightness_model(stage, log, np.zeros((stage.frames, 5, 3))))
    assert found.verdict == UNEXPLAINED


def test_lit_images_of_a_dark_log_are_unexplained(stage: Stage) -> None:
    rng = np.random.default_rng(0)
    seen = photograph(stage, random_groups(stage, rng), rng)
    assert checked(brightness_model(stage, all_dark(stage, rng), seen)).verdict == UNEXPLAINED


def test_units_of_intensity_and_brightness_do_not_matter(case: HardCase, stage: Stage) -> None:
    log = random_groups(stage, np.random.default_rng(0))
    seen = photograph(stage, log, np.random.default_rng(1))
    usual, small, bright = (
        checked(brightness_model(stage, factor * log, gain * seen)) for factor, gain in ((1, 1), (1e-6, 1), (1, 1e4))
    )
    for other in (small, bright):
        ahead = [[sync.sigmas_ahead[offset] for offset in usual.sigmas_ahead] for sync in (other, usual)]
        case.check(np.max(np.abs(np.divide(*ahead) - 1)), 1e-6)
        case.check(np.max(np.abs(other.powers.dead - usual.powers.dead) / usual.powers.dead), 1e-6)


def test_lights_in_one_place_are_not_told_apart_but_one_is_named(stage: Stage) -> None:
    rng = np.random.default_rng(4)
    log = random_groups(stage, rng)
    twin = replace(stage, lights=stage.lights.copy(), transport=stage.transport.copy())
    twin.lights[9], twin.transport[:, :, 9] = twin.lights[4], twin.transport[:, :, 4]
    shown = log.copy()
    shown[:, 4] = 0
    found = checked(brightness_model(twin, log, photograph(twin, shown, rng)))
    assert [fault.name for fault in found.faults] in (["L004"], ["L009"])


def test_cameras_in_one_place(case: HardCase, stage: Stage) -> None:
    rng = np.random.default_rng(4)
    log = random_groups(stage, rng)
    twin = replace(stage, cameras=np.repeat(stage.cameras[:1], 5, 0), transport=np.repeat(stage.transport[:, :1], 5, 1))
    found = checked(brightness_model(twin, log, photograph(twin, log, rng)))
    assert found.verdict == IN_SYNC
    case.check(len(found.faults), 0, unit="alarms")


def test_a_light_inside_the_subject_is_finite() -> None:
    subject = Ellipsoid(np.zeros(3), np.diag([0.3, 0.9, 0.2]))
    lights = np.array([[0.0, 0, 0], [0.0, 0.3, 0.1], [0.3, 0.0, 0.0]])
    response = shading_response(subject, lights, np.array([[0.0, 0, 2.0], [0.0, 3.0, 0.0]]))
    assert np.isfinite(response).all()
    assert (response >= 0).all()


def test_saturated_images_hide_neither_an_offset_nor_raise_alarms(case: HardCase, stage: Stage) -> None:
    """Pixels clip at 80 % of the brightest frame's mean."""
    rng = np.random.default_rng(3)
    log = random_groups(stage, rng)
    seen = photograph(stage, log, rng)
    clipped = np.minimum(seen, 0.8 * seen.max(0))
    assert checked(brightness_model(stage, log, clipped)).verdict == IN_SYNC
    late = checked(brightness_model(stage, log, clipped, numbers=np.arange(stage.frames) + 2))
    assert [fault.kind for fault in late.faults] == ["offset"]
    case.check(abs(late.faults[0].value - 2.0), 0, unit="frames")
