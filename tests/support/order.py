"""Order in which files of tests are handed to processes side by side."""

from __future__ import annotations

from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]

LONGEST_FIRST = (
    "unit/avatar/training/test_training.py",
    "stages/test_calibrate_photographs.py",
    "hard_cases/test_camera_calibration.py",
    "workflow/test_reruns.py",
    "workflow/test_tiny.py",
    "stages/test_train_processes.py",
    "stages/test_train_avatar.py",
    "stages/test_trained_glints.py",
    "stages/test_track_mesh.py",
    "hard_cases/test_color_calibration.py",
    "workflow/test_public_faces.py",
    "workflow/test_public_set.py",
    "unit/lighting/test_stored_kernels.py",
    "workflow/test_checks.py",
    "workflow/test_head_without_eyes.py",
    "unit/calibration/cameras/test_knock_rates.py",
    "stages/test_effect_scenes.py",
    "stages/test_book_patterns.py",
    "hard_cases/test_volumes.py",
    "stages/viewer/test_panel.py",
    "stages/viewer/test_light_controls.py",
    "stages/test_track_surface.py",
    "unit/calibration/lights/test_mirror_lights.py",
    "stages/test_write_report.py",
    "stages/test_measure_cost.py",
    "unit/calibration/cameras/test_rig_motion.py",
    "stages/viewer/test_poses.py",
    "stages/viewer/test_pictures.py",
    "stages/test_calibrate_features.py",
    "stages/test_calibrate_lights.py",
    "unit/calibration/cameras/test_board_identity.py",
    "hard_cases/test_light_calibration.py",
    "stages/test_drive_avatar.py",
    "stages/test_synthesize_capture.py",
    "chaos/test_chaos.py",
    "unit/base/test_stage_help.py",
    "stages/test_unwrap_atlas.py",
    "unit/synthesis/test_wavefront.py",
    "unit/avatar/training/test_light_refinement.py",
    "unit/avatar/eyes/test_eye_mirrors.py",
    "unit/base/test_watched_child.py",
    "stages/test_calibrate_walker.py",
    "mutants/test_mutants.py",
    "hard_cases/test_tracking.py",
    "unit/rendering/test_volume_march.py",
    "unit/calibration/cameras/test_fisheye_rig.py",
    "unit/metrics/test_scaling.py",
    "unit/metrics/test_ablation_table.py",
    "stages/test_export_capture.py",
    "unit/avatar/eyes/test_eye_lids.py",
    "unit/capture/schema/test_manifest.py",
    "unit/calibration/cameras/test_rig_uncertainty.py",
    "stages/test_index_capture.py",
    "stages/test_calibrate_fisheyes.py",
    "unit/avatar/eyes/test_eye_learning.py",
    "stages/test_review_tracking.py",
)
"""Files that take more than ten seconds, longest first: what comes last is short, so that all processes end nearly
together. A file that is missing here costs balance, nothing else. test_training comes first: a fresh clone compiles the
kernels of training in it, a minute, and what stands before test_tiny needs none of them."""


def longest_first(items: list[pytest.Item]) -> list[pytest.Item]:
    """The same tests, those of `LONGEST_FIRST` before all others; else as they were."""
    place = {TESTS / name: number for number, name in enumerate(LONGEST_FIRST)}
    return sorted(items, key=lambda item: place.get(item.path, len(place)))
