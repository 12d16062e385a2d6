"""Every planted fault is named, with confidence; a healthy stage raises no alarm, and what cannot be seen is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.sync.sync import FAULTY, IN_SYNC, UNDETERMINED, UNEXPLAINED, SyncCheck, check_sync
from tests.support.rigs.light_stage import (
    INTERLEAVINGS,
    Stage,
    brightness_model,
    build_stage,
    photograph,
    random_groups,
    white,
)

FRAMES = 30
SURE = 5.0


@pytest.fixture(scope="module")
def stage() -> Stage:
    return build_stage(3, frames=FRAMES, cameras=6, lights=20)


def named(check: SyncCheck) -> list[tuple[str, str]]:
    assert all(fault.sigmas >= SURE for fault in check.faults)
    return [(fault.kind, fault.name) for fault in check.faults]


@pytest.mark.parametrize("kind", INTERLEAVINGS)
def test_a_healthy_stage_raises_no_alarm(stage, kind):
    for seed in range(4):
        rng = np.random.default_rng(seed)
        log = INTERLEAVINGS[kind](stage, rng)
        found = check_sync(brightness_model(stage, log, photograph(stage, log, rng)))
        assert found.verdict in (IN_SYNC, UNDETERMINED), found.why
        assert (found.verdict == IN_SYNC) or kind in ("slow turn", "always fully lit")
        assert not found.frames.offset_frames.any()
        assert not found.frames.suspicious.any()


@pytest.mark.parametrize("kind", ["random groups", "one at a time", "dark frames", "environments"])
@pytest.mark.parametrize("by", [-5, -4, -3, -2, -1, 1, 2, 3, 4, 5])
def test_a_constant_offset_is_found(stage, kind, by):
    rng = np.random.default_rng(by + 10)
    log = INTERLEAVINGS[kind](stage, rng)
    # Images of frame f show the pattern logged for f + by.
    model = brightness_model(stage, log, photograph(stage, log, rng), numbers=np.arange(FRAMES) + by)
    found = check_sync(model)
    assert named(found) == [("offset", "0")], found.why
    assert (found.frames.offset_frames == by).all()
    assert found.verdict == FAULTY
    assert f"{by:+d}" in found.why


@pytest.mark.parametrize("row", [4, 15, 25])
def test_a_lost_and_a_doubled_image_are_found(stage, row):
    rng = np.random.default_rng(row)
    log = random_groups(stage, rng)
    seen = photograph(stage, log, rng)
    lost = check_sync(brightness_model(stage, log, np.delete(seen, row, 0)))
    assert named(lost) == [("missing_image", str(row))], lost.why
    assert lost.frames.offset_frames.tolist() == [0] * row + [1] * (FRAMES - 1 - row)
    twice = check_sync(brightness_model(stage, log, np.insert(seen, row, seen[row], 0)[:FRAMES]))
    assert named(twice) == [("doubled_image", str(row + 1))], twice.why
    assert twice.frames.offset_frames.tolist() == [0] * (row + 1) + [-1] * (FRAMES - 1 - row)


def test_where_equal_patterns_hide_the_place_of_a_lost_image_all_places_are_named(stage):
    rng = np.random.default_rng(0)
    log = random_groups(stage, rng)
    log[10:14] = log[10]
    found = check_sync(brightness_model(stage, log, np.delete(photograph(stage, log, rng), 12, 0)))
    assert [fault.kind for fault in found.faults] == ["missing_image"]
    assert "before frame 10 to 13" in found.why


@pytest.mark.parametrize("kind", ["random groups", "one at a time", "dark frames"])
def test_dead_and_stuck_lights_are_found(stage, kind):
    for light in (2, 11):
        rng = np.random.default_rng(light)
        log = INTERLEAVINGS[kind](stage, rng)
        level = log[log > 0].mean()
        for fault, shown_level in (("dead_light", 0.0), ("stuck_light", level)):
            shown = log.copy()
            shown[:, light] = shown_level
            found = check_sync(brightness_model(stage, log, photograph(stage, shown, rng)))
            assert named(found) == [(fault, stage.names[light])], found.why
            np.testing.assert_allclose(found.constants[stage.names[light]], shown_level, rtol=0.5, atol=1e-9)
            assert [verdict.name for verdict in found.lights if verdict.grade == "failed"] == [stage.names[light]]


def test_a_coloured_light_that_is_stuck_is_booked_in_its_colour(stage):
    rng = np.random.default_rng(5)
    log = random_groups(stage, rng) * np.array([1.0, 0.6, 0.2])
    shown = log.copy()
    shown[:, 4] = 4.0 * np.array([1.0, 0.6, 0.2])
    found = check_sync(brightness_model(stage, log, photograph(stage, shown, rng)))
    assert named(found) == [("stuck_light", "L004")]
    level = found.constants["L004"]
    np.testing.assert_allclose(level / level[0], [1.0, 0.6, 0.2], rtol=1e-6)
    assert level[0] == pytest.approx(4.0, rel=0.4)


def test_several_faults_at_once(stage):
    rng = np.random.default_rng(6)
    log = random_groups(stage, rng)
    shown = log.copy()
    shown[:, 7] = 0
    shown[16] = 0
    found = check_sync(brightness_model(stage, log, photograph(stage, shown, rng), numbers=np.arange(FRAMES) + 2))
    assert sorted(named(found)) == [("dead_light", "L007"), ("offset", "0"), ("wrong_pattern", "16")], found.why
    assert found.frames.frame[found.frames.suspicious].tolist() == [16]


def test_a_frame_under_another_pattern_is_found_and_the_pattern_named(stage):
    for seed, (frame, other) in enumerate([(7, 20), (13, 2), (22, 3)]):
        rng = np.random.default_rng(seed)
        log = random_groups(stage, rng)
        shown = log.copy()
        shown[frame] = log[other]
        found = check_sync(brightness_model(stage, log, photograph(stage, shown, rng)))
        assert named(found) == [("wrong_pattern", str(frame))], found.why
        assert np.allclose(log[int(found.faults[0].value)], log[other])  # 3 is fully lit, as others are


def test_a_dark_frame_among_fully_lit_ones(stage):
    rng = np.random.default_rng(0)
    log = INTERLEAVINGS["always fully lit"](stage, rng)
    shown = log.copy()
    shown[9] = 0
    assert named(check_sync(brightness_model(stage, log, photograph(stage, shown, rng)))) == [("wrong_pattern", "9")]


def test_a_dead_light_among_ever_lit_ones_cannot_be_seen_and_that_is_said(stage):
    rng = np.random.default_rng(0)
    log = INTERLEAVINGS["always fully lit"](stage, rng)
    shown = log.copy()
    shown[:, 5] = 0
    found = check_sync(brightness_model(stage, log, photograph(stage, shown, rng)))
    assert not found.faults
    assert {verdict.grade for verdict in found.lights} == {"weak"}
    assert "too little to tell" in found.lights[5].reason
    assert found.verdict == UNDETERMINED  # and nor can an offset


def test_images_of_another_capture_are_unexplained(stage):
    for seed in range(5):
        rng = np.random.default_rng(seed)
        log, shown = random_groups(stage, rng), random_groups(stage, rng, every=5)
        found = check_sync(brightness_model(stage, log, photograph(stage, shown, rng)))
        assert found.verdict == UNEXPLAINED, found.why


def test_an_offset_that_predicts_the_same_is_not_better(stage):
    rng = np.random.default_rng(0)
    log = random_groups(stage, rng)
    log[0::2], log[1::2] = log[1].copy(), log[2].copy()
    found = check_sync(brightness_model(stage, log, photograph(stage, log, rng)))
    assert found.verdict == IN_SYNC
    assert "only +2, -2, +4, -4" in found.why or "only -4, -2, +2, +4" in found.why


def test_missing_images(stage):
    rng = np.random.default_rng(1)
    log = random_groups(stage, rng)
    seen = photograph(stage, log, rng)
    model = brightness_model(stage, log, seen, numbers=np.arange(FRAMES) + 2)
    gaps = np.delete(np.arange(FRAMES), [5, 6, 14])
    found = check_sync(replace(model, frames=model.frames[gaps], seen=seen[gaps]))
    assert named(found) == [("offset", "0")], found.why


def test_one_camera_is_enough_for_an_offset(stage):
    rng = np.random.default_rng(2)
    log = random_groups(stage, rng)
    model = brightness_model(stage, log, photograph(stage, log, rng), numbers=np.arange(FRAMES) - 3)
    one = replace(
        model, seen=model.seen[:, :1], response=model.response[:1], camera_directions=model.camera_directions[:1]
    )
    found = check_sync(one)
    assert found.frames.offset_frames.unique().tolist() == [-3]


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_frames_say_little(stage, count):
    log = white(np.ones((count, 20)))
    few = replace(stage, transport=stage.transport[:count])
    found = check_sync(brightness_model(few, log, photograph(few, log, np.random.default_rng(0))))
    assert not found.faults
    assert np.isfinite(found.frames.drop(columns="frame").to_numpy(float)).all()
