"""Decibels that shadows of single rays cost (RFGCA A.3), by what the shadow network starts from, reads and sees.

    python -m benchmarks.bench_single_draws --results results/subjectA --steps 150

Asks for a finished run of a body. Trains the same avatar anew for each row, in this process and on the run's own
shards: with traced irradiance, with one ray per texel, and with one that neighbours share. Scores are of validation
images, in dB over the subject; `lit_by_all` scores the avatar that learned from single rays with the traced maps, so
that only training was noisy.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from benchmarks.marked_page import write_between
from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.model import Avatar
from pipeline.avatar.spec.planned import read_plan, resolve_spec
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.avatar.training.checkpoint import LoadedAvatar
from pipeline.avatar.training.training import Training
from pipeline.avatar.training.training_images import Schedule
from pipeline.base.seeds import generator_for
from pipeline.capture.records import FrameRecord, ImageRecord
from pipeline.capture.shards import read_frame_shards, read_image_shards
from pipeline.config.trace_irradiance import TraceIrradiance
from pipeline.config.train_avatar import TrainAvatar
from pipeline.geometry.texels import Atlas, read_atlas
from pipeline.lighting.frame_irradiance import FrameTracer, read_stage_lights
from pipeline.metrics.evaluation import scored_pair
from pipeline.metrics.images import psnr_db

TRACED = TraceIrradiance()
SINGLE = TraceIrradiance(samples="1", sampling="uniform", spread="random", share_rays=False)
"""A.3 to the letter: any of the lit lights, with the same probability, for each texel by itself."""

SHARED = TraceIrradiance(samples="1")
"""One ray per texel, and what its neighbours' rays found."""

ROWS: Mapping[str, Mapping[str, object]] = {
    "starts at the cosine's share, sees 7 texels": {"shadow_input": "cosine", "shadow_levels": 0},
    "starts at the cosine's share, sees 60 texels": {"shadow_input": "cosine", "shadow_levels": 3},
    "starts at a constant, last layer at zero": {"shadow_input": "cosine", "shadow_levels": 3},
    "starts as networks do, sees 7 texels": {"shadow_input": "irradiance", "shadow_levels": 0},
    "starts as networks do, sees 60 texels": {"shadow_input": "irradiance", "shadow_levels": 3},
}
"""Shadow networks: the default, and, last, the papers' preset."""

BLIND = "starts at a constant, last layer at zero"
"""The row whose network is given a constant in place of the cosine's share: it reads the irradiance alone, and differs
from the papers' by how it starts."""

USUAL_SHARE = 0.88
"""That constant: where the network that reads the irradiance alone starts, too."""

COLUMNS = {
    "network": "shadow network", "frames": "frames", "traced_db": "traced, dB", "single_rays_db": "single rays, dB",
    "lit_by_all_db": "learned from these, lit by traced, dB", "shared_db": "shared rays, dB",
}  # fmt: skip
"""Columns as printed, and as the page has them."""

FEWER = 3
"""The rows with fewer frames keep each third partially lit one."""


@dataclass(frozen=True)
class Scene:
    """All that trainings share: atlas, settings, and images of training and validation."""

    subject: str
    atlas: Atlas
    planned: set[str]
    images: Sequence[ImageRecord]
    validation: Sequence[ImageRecord]
    steps: int

    def trained(self, frames: Mapping[int, FrameRecord], few: bool, choices: Mapping[str, object]) -> LoadedAvatar:
        """An avatar after all steps on frames with their maps."""
        settings = TrainAvatar(
            shading="transfer", deferred="on", visibility="learned", indirect="none", weight_mask=0.1, weight_smooth=0,
            weight_negative=0.01, steps=self.steps, refine_lights=False, **choices,
        )  # fmt: skip
        partial = sorted({image.frame for image in self.images if not image.fully_lit})
        left_out = set(partial) - set(partial[::FEWER]) if few else set()
        images = [image for image in self.images if image.frame not in left_out]
        torch.manual_seed(0)
        avatar = Avatar(self.atlas, texel_spacing(self.atlas), resolve_spec(settings, self.planned))
        training, inputs = Training(avatar, settings, images=len(images)), {}
        schedule = Schedule(self.subject, [image.frame for image in images], settings.cameras_per_step)
        for step in range(self.steps):
            batch = [images[number] for number in schedule[step]]
            number = batch[0].frame
            inputs.setdefault(number, FrameInputs(self.atlas, frames[number]))
            training.take_step(step, inputs[number], batch)
        return LoadedAvatar(avatar, self.atlas)

    def score(self, avatar: LoadedAvatar, frames: Mapping[int, FrameRecord]) -> float:
        """Mean PSNR of the validation images, dB."""
        pairs = [scored_pair(avatar.render, image, frames[image.frame]) for image in self.validation]
        scores = [psnr_db(*pair, image.mask > 0.5) for pair, image in zip(pairs, self.validation, strict=True)]
        return float(np.mean(scores))


def with_maps(
    results: Path, atlas: Atlas, frames: Mapping[int, FrameRecord], settings: TraceIrradiance
) -> dict[int, FrameRecord]:
    """The frames with maps that were traced with some settings."""
    stage = read_stage_lights(results / "calibration/lights.parquet", results / "patterns.parquet")
    tracer, found = FrameTracer(atlas, stage, settings), {}
    for number, record in frames.items():
        random = generator_for(results.name, "trace_irradiance", number)
        traced = tracer.trace(number, record.vertices, random)
        maps = {"irradiance": traced.values, "cosine_visibility": traced.cosine_visibility}
        found[number] = replace(record, **{name: values.astype(np.float32) for name, values in maps.items()})
    return found


def blinded(frames: Mapping[int, FrameRecord]) -> dict[int, FrameRecord]:
    """The frames with a constant in place of the cosine's share."""
    return {
        number: replace(record, cosine_visibility=np.full_like(record.cosine_visibility, USUAL_SHARE))
        for number, record in frames.items()
    }


def page_lines(table: pd.DataFrame) -> list[str]:
    """The table of the page."""
    lines = ["| " + " | ".join(COLUMNS.values()) + " |", "|---" * len(COLUMNS) + "|"]
    for network, frames, *scores in table.itertuples(index=False):
        lines.append("| " + " | ".join([network, frames, *(f"{score:.2f}" for score in scores)]) + " |")
    return lines


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--results", type=Path, required=True, help="folder results/SUBJECT")
    parser.add_argument("--steps", type=int, default=150, help="of each training")
    parser.add_argument("--rows", nargs="+", choices=ROWS, default=list(ROWS), help="networks to train")
    parser.add_argument("--few", action="store_true", help="the first and the last row also with fewer frames")
    parser.add_argument("--page", type=Path, help="page with the marks single draws: begin and end")
    options = parser.parse_args()
    results, atlas = options.results, read_atlas(options.results / "atlas.safetensors")
    shards = {name: read_image_shards([results / "shards" / name]) for name in ("train", "validation")}
    images = {name: [each[number] for number in range(len(each))] for name, each in shards.items()}
    planned = read_plan(results / "effects.json") | {"shadow", "articulation", "specular"}
    scene = Scene(results.name, atlas, planned, images["train"], images["validation"], options.steps)
    frames = dict(read_frame_shards([results / "shards/frames"]).items())
    traced, single, shared = (with_maps(results, atlas, frames, settings) for settings in (TRACED, SINGLE, SHARED))
    rows = []
    with_few = [(name, True) for name in (next(iter(ROWS)), next(reversed(ROWS)))] if options.few else []
    for name, few in [(name, False) for name in options.rows] + with_few:
        clear, noisy, lent = (blinded(maps) if name == BLIND else maps for maps in (traced, single, shared))
        full, drawn, sharing = (scene.trained(maps, few, ROWS[name]) for maps in (clear, noisy, lent))
        pairs = (full, clear), (drawn, noisy), (drawn, clear), (sharing, lent)
        scores = [scene.score(*pair) for pair in pairs]
        rows.append((name, "third" if few else "all", *scores))
        print(rows[-1], flush=True)
    table = pd.DataFrame(rows, columns=list(COLUMNS))
    print(table.round(2).to_string(index=False))
    if options.page:
        write_between(options.page, f"single draws, {options.steps} steps", page_lines(table))


if __name__ == "__main__":
    main()
