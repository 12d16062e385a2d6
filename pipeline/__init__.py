"""Raw light-stage capture to relightable avatar, one file-to-file stage per module.

The stages are `pipeline.stages.NAME`, see `STAGES`. Below them lies the library; imports point down only
(tests/unit/test_layering.py has the layers).
"""

STAGES = (
    "synthesize_capture", "import_capture", "detect_landmarks", "segment_subject", "index_capture",
    "calibrate_cameras", "calibrate_color", "calibrate_lights", "review_calibration", "book_patterns", "unwrap_atlas",
    "track_mesh", "review_tracking", "estimate_gaze", "plan_effects", "fit_eyes", "trace_irradiance", "bake_textures",
    "pack_shards", "train_avatar", "evaluate_avatar", "relight_avatar", "export_viewer", "export_avatar",
    "export_capture", "check_budget", "measure_cost", "budget_errors", "write_report", "compare_subjects",
)  # fmt: skip
"""The stages in data order: each is a module of `pipeline.stages`, run by the rule of its name, with settings in the
section of its name."""
