"""What a synthetic capture holds out: partially lit frames of segment a, each for one reason."""

import pytest

from pipeline.base.errors import InputError
from pipeline.config.synthesize_capture import SynthesizeCapture
from pipeline.stages.synthesize_capture import check_settings
from pipeline.synthesis.capture_files import held_out
from pipeline.synthesis.stage_rig import build_stage_rig

SETTINGS = SynthesizeCapture(frames=30, frames_b=9, test_cameras=2, test_frames=3, test_patterns=4)


def test_frames_and_patterns_are_held_out_apart():
    splits = held_out(build_stage_rig("test", SETTINGS), SETTINGS)
    assert [len(splits[name]) for name in ("test_cameras", "test_frames", "test_patterns")] == [2, 3, 4]
    held = [*splits["test_frames"], *splits["test_patterns"]]
    assert len(set(held)) == 7
    assert all(frame < 21 and frame % SETTINGS.fully_lit_every for frame in held)


def test_no_more_than_there_are():
    check_settings("test", SETTINGS.model_copy(update={"test_frames": 10, "test_patterns": 4}))  # 14 are partially lit
    with pytest.raises(InputError, match="test_patterns: expected at most 4, what test_frames leaves of them, found 5"):
        check_settings("test", SETTINGS.model_copy(update={"test_frames": 10, "test_patterns": 5}))
