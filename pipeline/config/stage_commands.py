"""Command lines of the stages: which file of a subject's results feeds which flag.

The workflow's rules and the dials of measure_cost both start stages with these words; settings come from
`pipeline.config.flags`, and threads, which change no result, stay with whoever starts the stage.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

Value = str | Sequence[str]
"""Words after a flag; none at all leave the flag out."""

FILES = {
    "results": ".",
    "detected": "detected",
    "index": "index",
    "calibration": "calibration",
    "rig": "calibration/rig.json",
    "cameras": "calibration/cameras.json",
    "lights": "calibration/lights.parquet",
    "color": "calibration/color.json",
    "patterns": "patterns.parquet",
    "frames": "frames.parquet",
    "atlas": "atlas.safetensors",
    "trackings": "tracking",
    "tracking": "tracking/{chunk}.safetensors",
    "tracking_review": "tracking/review",
    "effects": "effects.json",
    "estimated_gaze": "gaze.parquet",
    "eyes": "eyes.json",
    "irradiance": "irradiance/{chunk}",
    "visibility": "visibility",
    "baked": "textures/{chunk}",
    "textures": "textures/{chunk}.safetensors",
    "shards": "shards",
    "avatar": "avatars/{variant}",
    "scores": ".",
    "budget": "budget.csv",
    "error_budget": "error_budget",
    "page": "report/index.html",
    "viewer": "viewer/index.html",
    "export": "export",
}
"""Files and folders below results/SUBJECT, by name."""

ARGUMENTS = {
    "synthesize_capture": "subject out=capture",
    "import_capture": "dataset source subject out=capture",
    "detect_landmarks": "capture out=detected",
    "segment_subject": "capture out=detected",
    "index_capture": "capture detected_keypoints detected_masks out=index",
    "calibrate_cameras": "capture index out=calibration",
    "calibrate_color": "capture index out=calibration",
    "calibrate_lights": "capture index rig out=calibration",
    "review_calibration": "capture index calibration out=calibration",
    "book_patterns": "capture index lights cameras out=results",
    "unwrap_atlas": "capture index cameras=rig out=results",
    "track_mesh": "capture index cameras lights patterns chunk chunk_size out=trackings",
    "review_tracking": "capture index calibration patterns tracking out=tracking_review",
    "estimate_gaze": "capture index atlas tracking cameras frames out=estimated_gaze",
    "plan_effects": "capture index atlas tracking patterns booked=frames lights cameras color "
    "estimated_gaze=gaze out=effects",
    "fit_eyes": "index atlas tracking estimated_gaze=gaze out=eyes",
    "trace_irradiance": "subject atlas tracking lights patterns frames out=irradiance cache=visibility",
    "bake_textures": "capture index atlas tracking cameras color effects frames out=baked",
    "pack_shards": "capture index atlas tracking cameras color lights effects patterns frames chunk chunk_size "
    "irradiance textures estimated_gaze=gaze out=shards",
    "train_avatar": "subject atlas shards frames=frame_shards effects fitted_eyes=eyes "
    "given_geometry=geometry out=avatar",
    "evaluate_avatar": "subject index atlas shards frames=frame_shards effects avatars=avatar out=scores",
    "relight_avatar": "atlas avatar tracking textures index estimated_gaze=gaze cameras environment lights=light_list "
    "shards=captured out=relit",
    "export_viewer": "subject atlas avatar shards frames=frame_shards index lights patterns out=viewer",
    "export_avatar": "capture atlas avatar shards frames=frame_shards index cameras lights patterns tracking "
    "out=export",
    "export_capture": "subject layout capture index cameras color lights=lights_of_layout patterns=patterns_of_layout "
    "tracking out=exported",
    "check_budget": "results estimate out=budget",
    "measure_cost": "results capture out=results chunk_size variant stage_settings",
    "budget_errors": "results capture out=error_budget chunk_size variant stage_settings",
    "write_report": "results project_results subject_settings requests out=page",
    "compare_subjects": "scores=score_tables out=project_results",
}
"""Stage -> its flags; `flag=name` where the file is called otherwise."""

OPTIONAL = ("estimated_gaze", "given_geometry")
"""Flags of files that most jobs do without: a gaze that the capture does not declare, a geometry that another avatar
learned. Without a value, none is handed over."""

THREADED = ("calibrate_cameras", "calibrate_color", "calibrate_lights", "review_calibration", "review_tracking",
            "trace_irradiance", "measure_cost", "budget_errors")  # fmt: skip
"""Stages with a flag --threads."""


def subject_files(results: str | Path, chunk: str | None = None, variant: str | None = None) -> dict[str, str]:
    """Paths of `FILES` in a subject's results.

    Without a chunk or a variant, those that belong to one are left out.
    """
    known = {"chunk": chunk, "variant": variant}
    absent = [f"{{{name}}}" for name, value in known.items() if value is None]
    kept = {name: place for name, place in FILES.items() if not any(mark in place for mark in absent)}
    return {name: os.path.normpath(os.path.join(results, place.format(**known))) for name, place in kept.items()}


def stage_arguments(stage: str, values: Mapping[str, Value]) -> list[str]:
    """Words after `python -m pipeline.stages.STAGE`, without settings and threads.

    Args:
        stage: name of the module in `pipeline.stages`.
        values: what `ARGUMENTS` names; a flag without words is left out.

    Raises:
        KeyError: if a name has no value.
    """
    words: list[str] = []
    for flag, _, name in (part.partition("=") for part in ARGUMENTS[stage].split()):
        value = values.get(name or flag, ()) if flag in OPTIONAL else values[name or flag]
        given = [value] if isinstance(value, str) else list(value)
        words += [f"--{flag.replace('_', '-')}", *given] if given else []
    return words
