"""Dials of earlier stages, judged by an avatar trained on what they make.

The images of that avatar are compared (RFGCA, Table A.1).
"""

from __future__ import annotations

import math
from dataclasses import replace

import pandas as pd

from pipeline.base.files import read_json, read_table
from pipeline.dials.dial import Dial, Files, Metric, Subject
from pipeline.dials.irradiance import INPUTS, IRRADIANCE

WITHIN_DB = 0.1
"""Difference of PSNR that nobody sees, and about what another seed makes."""

LEAST_DB = 0.01
"""Losses below this, gains among them, count as this: the last digit that metrics are quoted with."""

STEPS = 200
"""Of trainings that compare settings: differences between them show by then, and hardly grow afterwards."""

MADE = {
    "irradiance": "{out}/0000", "baked": "{out}/textures/0000", "textures": "{out}/textures/0000.safetensors",
    "shards": "{out}/shards", "avatar": "{out}/avatars/full", "scores": "{out}",
}  # fmt: skip
"""Where the stages from tracing on write, and those after them read, if all of them run."""

AFTER_TRACING = ("bake_textures", "pack_shards", "train_avatar", "evaluate_avatar")
"""Stages from maps to scores, in order."""


def psnr_lost(lit: str) -> Metric:
    """Metric: PSNR lost against the reference, under one kind of light.

    Light is all, full or partial; the images are the test images.
    """

    def psnr_db(files: Files) -> float:
        table = pd.read_csv(files["metrics"])
        return float(table.psnr_db[(table.split == "test") & (table.lit == lit)].mean())

    def error(subject: Subject, output: Files, expected: Files) -> float:
        return max(psnr_db(expected) - psnr_db(output), LEAST_DB)

    return Metric(f"PSNR lost on test images, {lit} lit, dB", error, lambda subject: WITHIN_DB)


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
    outputs={**IRRADIANCE.outputs, "metrics": ("metrics.csv", None)},
    metrics=(psnr_lost("partial"), psnr_lost("all")),
    runs_on=one_chunk,
    files=MADE,
    afterwards=AFTER_TRACING,
    later_settings={"train_avatar": {"steps": STEPS}},
    warm_up={},
)

TRAINED_DIALS = [
    Dial("trained_irradiance", TRACED_AND_TRAINED, "samples", lambda subject: ("1", "4", "full")),
]
