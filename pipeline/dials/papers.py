"""Dials of the papers' own choices, turned on their models.

Zonal or harmonic transfer and a lobe per pixel, without the shadow network but where its width is the question.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, get_args

from pipeline.base.files import read_json
from pipeline.capture.shards import read_frame_shards
from pipeline.config.trained_model import DepthSource, Geometry
from pipeline.dials.dial import Dial
from pipeline.dials.subject import Subject
from pipeline.dials.trained import STEPS
from pipeline.dials.training import SHORT_TRAINING

PAPERS: Mapping[str, Any] = {"steps": STEPS, "shading": "transfer", "deferred": "on"}
WITHOUT_NETWORK = {**PAPERS, "shadow": "off"}
DECODED = {**WITHOUT_NETWORK, "parameters": "decoded"}

CODE_SIZES = (4, 8, 32, 16)
"""Numbers of a pose's code; the last one is the reference, and the default."""

DECODERS = ((8,), (32, 16, 8), (16, 8))
"""Channels of decoders: a layer less, a layer more, and the default."""


def is_head(subject: Subject) -> bool:
    """True if the capture is of a head."""
    return str(read_json(subject.results / "index/capture.json")["kind"]) == "head"


def has_maps(subject: Subject) -> bool:
    """True if shards hold traced irradiance maps, which the shadow network reads."""
    records = read_frame_shards([subject.results / "shards/frames"])
    return any((record.irradiance != 1).any() for record in records.values())


BODY = replace(SHORT_TRAINING, runs_on=lambda subject: not is_head(subject))
HEAD = replace(SHORT_TRAINING, runs_on=is_head)
SHADOWED = replace(SHORT_TRAINING, runs_on=has_maps)

PAPERS_DIALS = [
    # Where a lobe is evaluated per pixel; the default avatar has it per Gaussian.
    Dial("depth", BODY, "depth", lambda subject: get_args(DepthSource), WITHOUT_NETWORK),
    Dial("transfer_degree", BODY, "transfer_degree", lambda subject: (1, 2, 3, 5, 8), WITHOUT_NETWORK),
    Dial("texels_or_networks", BODY, "parameters", lambda subject: ("texels", "decoded"), WITHOUT_NETWORK),
    Dial("code_size", BODY, "code_size", lambda subject: CODE_SIZES, DECODED),
    Dial("decoder_layers", BODY, "decoder_channels", lambda subject: DECODERS, DECODED),
    Dial("shadow_field", SHADOWED, "shadow_levels", lambda subject: (0, 1, 2), {**PAPERS, "shadow": "on"}),
    Dial(
        "gaussians_or_volumes", HEAD, "geometry", lambda subject: get_args(Geometry)[::-1],
        {**WITHOUT_NETWORK, "eyes": "off"},
    ),
    Dial("cameras_per_step", SHORT_TRAINING, "cameras_per_step", lambda subject: (1, 4, 2), {"steps": STEPS}),
    Dial("refined_lights", SHORT_TRAINING, "refine_lights", lambda subject: (False, True), {"steps": STEPS}),
    Dial("refined_cameras", SHORT_TRAINING, "refine_cameras", lambda subject: (False, True), {"steps": STEPS}),
]  # fmt: skip
