"""Dials of earlier stages, judged by the images of an avatar trained on what they make (RFGCA, Table A.1)."""

from __future__ import annotations

import math
from dataclasses import replace

import pandas as pd

from pipeline.base.files import read_json, read_table
from pipeline.dials.dial import Dial, Files, Metric, Subject
from pipeline.dials.irradiance import INPUTS, IRRADIANCE, TRACED

WITHIN_DB = 0.1
"""Difference of PSNR that nobody sees, and about what another seed makes."""

LEAST_DB = 0.01
"""Losses below this, gains among them, count as this: the last digit that metrics are quoted with."""

STEPS = 200
"""Of trainings that compare settings: differences between them show by then, and hardly grow afterwards."""

TRAINED = {
    "trace_irradiance": TRACED,
    "bake_textures": "--capture {capture} --index {results}/index --atlas {results}/atlas.safetensors "
    "--tracking {results}/tracking/0000.safetensors --cameras {results}/calibration/cameras.json "
    "--color {results}/calibration/color.json --effects {results}/effects.json --frames {results}/frames.parquet "
    "--out {out}/textures/0000",
    "pack_shards": "--capture {capture} --index {results}/index --atlas {results}/atlas.safetensors "
    "--tracking {results}/tracking/0000.safetensors --cameras {results}/calibration/cameras.json "
    "--color {results}/calibration/color.json --lights {results}/calibration/lights.parquet "
    "--effects {results}/effects.json --patterns {results}/patterns.parquet --frames {results}/frames.parquet "
    "--chunk 0 --chunk-size {chunk_size} --irradiance {out}/0000 "
    "head:--textures head:{out}/textures/0000.safetensors --out {out}/shards",
    "train_avatar": "--subject {subject} --atlas {results}/atlas.safetensors --shards {out}/shards "
    "--effects {results}/effects.json eyes:--fitted-eyes eyes:{results}/eyes.json --out {out}/avatars/full",
    "evaluate_avatar": "--subject {subject} --atlas {results}/atlas.safetensors --shards {out}/shards "
    "--effects {results}/effects.json --avatars {out}/avatars/full --out {out}",
}


def psnr_lost(lit: str) -> Metric:
    """How far the test images under such light (all, full, partial) fall behind the reference's."""

    def psnr_db(files: Files) -> float:
        table = pd.read_csv(files["metrics"])
        return float(table.psnr_db[(table.split == "test") & (table.lit == lit)].mean())

    def error(subject: Subject, output: Files, expected: Files) -> float:
        return max(psnr_db(expected) - psnr_db(output), LEAST_DB)

    return Metric(f"PSNR lost on test images, {lit} lit, dB", error, lambda subject: WITHIN_DB)


def picture_milliseconds() -> Metric:
    """What a picture of the avatar takes, from a new pose and light on."""

    def error(subject: Subject, output: Files, expected: Files) -> float:
        return float(pd.read_csv(output["costs"]).render_milliseconds.iloc[0])

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
    afterwards={stage: words for stage, words in TRAINED.items() if stage != IRRADIANCE.name},
    later_settings={"train_avatar": {"steps": STEPS}},
    warm_up={},
)

TRAINED_DIALS = [
    Dial("trained_irradiance", TRACED_AND_TRAINED, "samples", lambda subject: ("1", "4", "full")),
]
