"""Dials of trace_irradiance."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pandas as pd

from pipeline.base.files import read_table
from pipeline.capture.images import read_exr_channel
from pipeline.dials.dial import CostedStage, Dial, Files, Metric
from pipeline.dials.subject import Subject
from pipeline.lighting.light_sampling import SamplePattern

TOLERANCE = 0.01
"""RMS error of irradiance, fully lit and unoccluded being 1: 1 % of full scale, the noise of a capture (40 dB)."""


def _irradiance(subject: Subject, output: Files, expected: Files) -> float:
    """Over the texels of all maps; outside the charts all maps are 0."""
    table, squares = read_table(output["table"]), 0.0
    for frame in table.frame:
        found, wanted = (read_exr_channel(files["maps"] / f"{frame:06d}.exr") for files in (output, expected))
        squares += float(np.square(found - wanted, dtype=np.float64).sum())
    return float(np.sqrt(squares / table.texels.sum()))


INPUTS = (
    "atlas.safetensors", "tracking/0000.safetensors", "calibration/lights.parquet", "patterns.parquet",
    "frames.parquet",
)  # fmt: skip


def _rays(output: Files) -> int:
    return int(read_table(output["table"]).rays.sum())


IRRADIANCE = CostedStage(
    name="trace_irradiance",
    files={"irradiance": "{out}/0000"},
    inputs=INPUTS,
    outputs={"maps": ("0000", None), "table": ("0000.parquet", None)},
    metrics=(Metric("irradiance, RMS", _irradiance, lambda subject: TOLERANCE),),
    unit="rays",
    work=_rays,
)


def _samples(subject: Subject) -> list[str]:
    """Powers of two up to the most lights that are on in a frame, then all."""
    lit: pd.Series = read_table(subject.results / "patterns.parquet").groupby("frame").light.count()
    most = int(lit.max()) if len(lit) else 1
    return [*(str(2**k) for k in range(int(np.ceil(np.log2(max(most, 2)))))), "full"]


IRRADIANCE_DIALS = [
    *(
        Dial(f"irradiance_{sampling}", IRRADIANCE, "samples", _samples, {"sampling": sampling}, chosen=chosen)
        for sampling, chosen in (("uniform", False), ("power", True), ("arriving", False))
    ),
    # As the papers draw them: each texel by itself.
    Dial("irradiance_alone", IRRADIANCE, "samples", _samples, {"sampling": "power", "share_rays": False}),
    Dial(
        "irradiance_spread", IRRADIANCE, "spread", lambda subject: get_args(SamplePattern), {"samples": "1"},
        reference={"samples": "full"},
    ),
    Dial("irradiance_visibility", IRRADIANCE, "visibility", lambda subject: ("cached", "traced")),
]  # fmt: skip
