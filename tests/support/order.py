"""Order in which files of tests are handed to processes side by side."""

from __future__ import annotations

from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]

LONGEST_FIRST = (
    "workflow/test_tiny.py",
    "unit/avatar/training/test_training.py",
    "stages/test_viewer_in_browser.py",
    "stages/test_calibrate_photographs.py",
    "stages/test_train_processes.py",
    "workflow/test_reruns.py",
    "workflow/test_head_without_eyes.py",
    "workflow/test_public_set.py",
    "stages/test_track_mesh.py",
    "stages/test_trained_glints.py",
    "workflow/test_checks.py",
    "stages/test_effect_scenes.py",
    "unit/calibration/cameras/test_knock_rates.py",
    "hard_cases/test_tracking.py",
    "unit/calibration/lights/test_mirror_lights.py",
    "unit/lighting/test_stored_kernels.py",
    "unit/calibration/cameras/test_fisheye_rig.py",
    "hard_cases/test_camera_calibration.py",
    "stages/test_track_surface.py",
)
"""Files that take more than 15 s of a processor, longest first: what comes last is short, so that all processes end
nearly together. A file that is missing here costs balance, nothing else. test_training comes early: in a fresh clone
it compiles the kernels of training, half a minute, while test_tiny has not come to them yet."""


def longest_first(items: list[pytest.Item]) -> list[pytest.Item]:
    """The same tests, those of `LONGEST_FIRST` before all others; else as they were."""
    place = {TESTS / name: number for number, name in enumerate(LONGEST_FIRST)}
    return sorted(items, key=lambda item: place.get(item.path, len(place)))
