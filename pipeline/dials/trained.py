"""Dials of earlier stages, judged by an avatar trained on what they make.

The images of that avatar are compared (RFGCA, Table A.1).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pandas as pd

from pipeline.base.errors import InputError
from pipeline.base.files import read_json, read_table
from pipeline.dials.dial import Dial, Files, Metric
from pipeline.dials.irradiance import INPUTS, IRRADIANCE
from pipeline.dials.subject import Subject
from pipeline.dials.tracking import TRACKING
from pipeline.metrics.evaluation import LIT, capped
from pipeline.metrics.significance import Estimate, mean_over_images

WITHIN_DB = 0.1
"""Difference of PSNR that nobody sees, and about what another seed makes."""

STEPS = 200
"""Of trainings that compare settings: differences show by then; those of texels shrink in longer ones."""

DRAFT_STEPS = 400
"""Of those that compare sizes of texels and samples, which budgets turn together with steps: as many as a draft has."""

MADE = {
    "irradiance": "{out}/0000", "baked": "{out}/textures/0000", "textures": "{out}/textures/0000.safetensors",
    "shards": "{out}/shards", "avatar": "{out}/avatars/full", "scores": "{out}",
}  # fmt: skip
"""Where the stages from tracing on write, and those after them read, if all of them run."""

PER_IMAGE = ("metrics_per_image.parquet", None)
"""Scores of every image, of which no truth is known."""

ON_VALIDATION = {"splits": ("validation",), "pictures": False}
"""How avatars are scored: settings are never chosen on test images."""

AFTER_TRACING = ("bake_textures", "pack_shards", "train_avatar", "evaluate_avatar")
"""Stages from maps to scores, in order."""


def psnr_lost(lit: str) -> Metric:
    """Metric: PSNR lost against the reference, under one kind of light.

    It is compared image by image, with a standard error. Light is all, full or partial; the images are the validation
    images. What is gained is less than 0.
    """

    def lost(subject: Subject, output: Files, expected: Files) -> Estimate:
        tables = [read_table(files["per_image"]) for files in (expected, output)]
        better, worse = (capped(table[table.validation & LIT[lit](table)]) for table in tables)
        if better[["camera", "frame"]].values.tolist() != worse[["camera", "frame"]].values.tolist():
            raise InputError(f"{output['per_image']}: expected the images of {expected['per_image']}, found others")
        difference = better.psnr_db.to_numpy(np.float64) - worse.psnr_db.to_numpy(np.float64)
        return mean_over_images(difference, better.frame.to_numpy())

    return Metric(
        f"PSNR lost on validation images, {lit} lit, dB", lambda *files: lost(*files).mean,
        lambda subject: WITHIN_DB, lambda *files: lost(*files).error,
    )  # fmt: skip


def picture_milliseconds() -> Metric:
    """Metric: time of a picture of the avatar, from a new pose and light on."""

    def error(subject: Subject, output: Files, expected: Files) -> float:
        return float(pd.read_csv(output["times"]).render_milliseconds.iloc[0])

    return Metric("time of a picture, ms", error, lambda subject: math.inf)


def one_chunk(subject: Subject) -> bool:
    """Shadows are on, and all frames are in the chunk that is traced again."""
    shadow = read_json(subject.results / "effects.json")["shadow"]["on"]
    return shadow and len(read_table(subject.results / "frames.parquet")) <= subject.chunk_size


TRACED_AND_TRAINED = replace(
    IRRADIANCE,
    inputs=(*INPUTS, "effects.json", "calibration/color.json"),
    outputs={**IRRADIANCE.outputs, "per_image": PER_IMAGE},
    metrics=(psnr_lost("partial"), psnr_lost("all")),
    runs_on=one_chunk,
    files=MADE,
    afterwards=AFTER_TRACING,
    later_settings={"train_avatar": {"steps": STEPS}, "evaluate_avatar": ON_VALIDATION},
    seeded="train_avatar",
    warm_up={},
)

TRACKED_AND_TRAINED = replace(
    TRACKING,
    files={"trackings": "{out}/tracking", "tracking": "{out}/tracking/0000.safetensors", **MADE},
    inputs=(*TRACKING.inputs, "atlas.safetensors", "frames.parquet", "effects.json", "calibration/color.json"),
    outputs={"tracking": ("tracking/0000.safetensors", None), "per_image": PER_IMAGE},
    metrics=(psnr_lost("partial"), psnr_lost("all")),
    runs_on=one_chunk,
    afterwards=("trace_irradiance", *AFTER_TRACING),
    later_settings={"train_avatar": {"steps": STEPS}, "evaluate_avatar": ON_VALIDATION},
    seeded="train_avatar",
    warm_up={},
)

TRAINED_DIALS = [
    # Vertices tell too little: pictures lose far more to some millimetres than to others. Eyes stay as they were.
    Dial("trained_outlines", TRACKED_AND_TRAINED, "outline_rounds", lambda subject: (0, 1, 2, 5, 8), chosen=True),
    Dial("trained_irradiance", TRACED_AND_TRAINED, "samples", lambda subject: ("1", "4", "full")),
]
