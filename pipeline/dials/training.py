"""Dials of train_avatar and of the atlas, judged by the images of short trainings.

Partially lit images decide: they tell models apart, fully lit ones hardly do. How long a training has to be is a dial
of its own; texels and samples are turned at `DRAFT_STEPS`, the others at `STEPS`, all alike.
"""

from __future__ import annotations

from pipeline.base.files import read_json, read_table
from pipeline.dials.dial import CostedStage, Dial
from pipeline.dials.subject import Subject
from pipeline.dials.trained import (
    AFTER_TRACING,
    DRAFT_STEPS,
    MADE,
    ON_VALIDATION,
    PER_IMAGE,
    STEPS,
    one_chunk,
    picture_milliseconds,
    psnr_lost,
)

OUTPUTS = {
    "per_image": PER_IMAGE, "times": ("avatar_times.csv", None), "trained": ("avatars/full/config.json", None)
}  # fmt: skip

SHORT_TRAINING = CostedStage(
    name="train_avatar",
    files={"avatar": "{out}/avatars/full", "scores": "{out}"},
    inputs=(
        "atlas.safetensors",
        "effects.json",
        "index/images.parquet",
        "shards/train",
        "shards/frames",
        "shards/validation",
    ),
    outputs=OUTPUTS,
    metrics=(psnr_lost("partial"), psnr_lost("all"), picture_milliseconds()),
    unit="steps",
    work=lambda output: read_json(output["trained"])["settings"]["steps"],
    afterwards=("evaluate_avatar",),
    later_settings={"evaluate_avatar": ON_VALIDATION},
    seeded="train_avatar",
    warm_up={"steps": 1},
)

ATLAS = CostedStage(
    name="unwrap_atlas",
    files={"results": "{out}", "atlas": "{out}/atlas.safetensors", **MADE},
    inputs=(
        "index/capture.json", "calibration/rig.json", "tracking/0000.safetensors", "calibration/lights.parquet",
        "patterns.parquet", "frames.parquet", "effects.json", "calibration/color.json",
    ),
    outputs=OUTPUTS,
    metrics=(psnr_lost("partial"), psnr_lost("all"), picture_milliseconds()),
    unit="texels",
    work=lambda output: read_json(output["trained"])["texels"],
    runs_on=one_chunk,
    afterwards=("trace_irradiance", *AFTER_TRACING),
    timed=("trace_irradiance", "train_avatar"),
    later_settings={"train_avatar": {"steps": DRAFT_STEPS}, "evaluate_avatar": ON_VALIDATION},
    seeded="train_avatar",
    warm_up={},
)  # fmt: skip


def _camera_counts(subject: Subject) -> list[int]:
    """Some of the cameras that are trained on, then, as 0, all."""
    images = read_table(subject.results / "index/images.parquet")
    trained = images.camera[~images.test_camera].nunique()
    return [*(count for count in CAMERA_COUNTS if count < trained), 0]


CAMERA_COUNTS = (2, 4, 8, 16, 32, 64)

AT_STEPS = {"steps": STEPS}

AT_DRAFT_STEPS = {"steps": DRAFT_STEPS}

TRAINING_DIALS = [
    Dial("texel_size", ATLAS, "texel_pixels", lambda subject: (1.2, 0.9, 0.6, 0.45), chosen=True),
    Dial("dilation", SHORT_TRAINING, "dilation_px2", lambda subject: (0.3, 0.1, 0.01, 0.03), AT_STEPS),
    Dial("compensation", SHORT_TRAINING, "compensate_opacity", lambda subject: (True, False), AT_STEPS),
    Dial("supersampling", SHORT_TRAINING, "supersample", lambda subject: (1, 2, 3), AT_DRAFT_STEPS, chosen=True),
    Dial("albedo_start", SHORT_TRAINING, "albedo_start", lambda subject: ("grey", "images"), AT_STEPS),
    Dial("highlight", SHORT_TRAINING, "highlight", lambda subject: ("cosine", "angular", "half"), AT_STEPS),
    # What a smaller stage, or a shorter session, would have cost (RGCA, figures S4 and S5).
    Dial("training_cameras", SHORT_TRAINING, "cameras", _camera_counts, AT_STEPS),
    Dial("training_lights", SHORT_TRAINING, "light_share", lambda subject: (0.1, 0.2, 0.5, 1.0), AT_STEPS),
    Dial("training_steps", SHORT_TRAINING, "steps", lambda subject: (100, 200, 400, 800, 1600), chosen=True),
]
