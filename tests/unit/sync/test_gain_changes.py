"""Changes of exposure in a traced recording: each is found where it is, and none where there is none."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.sync.gain_changes import find_gain_changes
from pipeline.sync.led_faults import Patterns
from tests.support.rigs.light_stage import brightness_model, build_stage, photograph, random_groups

FRAMES, CAMERAS = 30, 6


@pytest.fixture(scope="module")
def recorded():
    stage = build_stage(3, frames=FRAMES, cameras=CAMERAS, lights=20)
    rng = np.random.default_rng(0)
    log = random_groups(stage, rng)
    return stage, log, photograph(stage, log, rng)


def changes(recorded, part=None, factor=1.0):
    stage, log, seen = recorded
    seen = seen.copy()
    if part is not None:
        seen[part] *= factor
    return find_gain_changes(brightness_model(stage, log, seen), Patterns(log.mean(2), np.ones(FRAMES, bool)))


def test_a_steady_recording_has_no_changes(recorded):
    assert changes(recorded) == []


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_frame_of_another_exposure_is_told_from_one_of_its_images(recorded, factor):
    (frame,) = changes(recorded, np.s_[12], factor)
    (image,) = changes(recorded, np.s_[12, 4], factor)
    assert (frame.camera, frame.frame, frame.lasting) == (None, 12, False)
    assert (image.camera, image.frame, image.lasting) == (4, 12, False)
    for found in (frame, image):
        assert found.factor == pytest.approx(factor, rel=0.25)  # a body's shading is known to 20 %
        assert np.sign(found.sigmas) == np.sign(factor - 1)


def test_a_change_that_lasts_is_told_from_frames_and_has_its_camera(recorded):
    (one,) = changes(recorded, np.s_[15:, 2], 1.6)
    (every,) = changes(recorded, np.s_[15:], 1.6)
    assert (one.camera, one.lasting) == (2, True) and (every.camera, every.lasting) == (None, True)
    assert abs(one.frame - 15) < 2 and abs(every.frame - 15) < 2
    assert one.factor == pytest.approx(1.6, rel=0.15) and every.factor == pytest.approx(1.6, rel=0.15)
    assert str(every).startswith(f"{every.factor:.2f} times as bright from frame {every.frame} on")


def test_less_than_a_click_of_a_dial_is_no_lasting_change(recorded):
    assert not [change for change in changes(recorded, np.s_[15:], 1.05) if change.lasting]
