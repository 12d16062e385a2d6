"""Seconds that the stages up to metrics.csv should take, at the defaults of the dials.

The costs of `pipeline.budget.job_costs`, for what can be known of a capture before anything has run.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from pipeline.budget import job_costs
from pipeline.budget.capture_size import CaptureSize
from pipeline.budget.job_costs import CHUNKED, looked_at, read_costs
from pipeline.budget.job_size import size_of_whole
from pipeline.config.effects import EFFECTS
from pipeline.config.project import SubjectSettings
from pipeline.config.sections import section_for

ON_THE_WAY = (
    "index_capture", "calibrate_cameras", "calibrate_color", "calibrate_lights", "book_patterns", "unwrap_atlas",
    "track_mesh", "plan_effects", "fit_eyes", "trace_irradiance", "bake_textures", "pack_shards", "train_avatar",
    "evaluate_avatar",
)  # fmt: skip
"""Stages on the way to metrics.csv, in data order; some captures need not all of them."""

TEXELS_PER_PIXEL = {"body": 1.6, "head": 4.6}
"""Texels of an atlas per pixel of an image, at the default size of texels: bodies had 1.54, 1.60 and 1.69; a head with
hair 4.52, and another 4.60 and 4.68, at sizes at which they do not fill an atlas."""

COVERED = 0.45
"""Share of an atlas that carries texels: bodies had 0.41, 0.41 and 0.58, a head 0.45."""


@dataclass(frozen=True)
class StageSeconds:
    """Seconds of a stage: those of its start, and those of its work.

    Start is also what training takes before its first step.
    """

    fixed: float
    work: float

    def times(self, factor: float) -> StageSeconds:
        """Both, times a factor."""
        return StageSeconds(factor * self.fixed, factor * self.work)


def run_seconds(settings: SubjectSettings, capture: CaptureSize) -> dict[str, StageSeconds]:
    """Seconds of a processor that each stage is expected to take.

    Raises:
        InputError: if the costs cannot be read.
    """
    costs = read_costs(job_costs.TABLE)
    texels, chunks = expected_texels(settings, capture), math.ceil(capture.frames / settings.chunk_frames)
    whole = size_of_whole(settings, capture, texels, list(settings.variants))
    avatars = [size_of_whole(settings, capture, texels, [name]) for name in settings.variants]
    found = {}
    for stage in stages_on_the_way(settings, capture):
        terms = costs[stage, "seconds"]
        jobs = chunks if stage in CHUNKED else 1
        own = [looked_at(stage, size) for size in (avatars if stage == "train_avatar" else [whole])]
        start = [terms.before_steps(size) for size in own]
        work = sum(terms.expected(size) for size in own) - sum(start)
        found[stage] = StageSeconds(jobs * sum(start), work)
    return found


def stages_on_the_way(settings: SubjectSettings, capture: CaptureSize) -> list[str]:
    """Stages that a run to metrics.csv needs, with all effects planned, in data order."""
    trained = [section_for(settings, "train_avatar", variant) for variant in settings.variants]
    needed = {
        "fit_eyes": capture.kind == "head",
        "trace_irradiance": any(section.reads_irradiance(EFFECTS, capture.kind) for section in trained),
        "bake_textures": any(section.reads_textures(capture.kind) for section in trained),
    }
    return [stage for stage in ON_THE_WAY if needed.get(stage, True)]


def expected_texels(settings: SubjectSettings, capture: CaptureSize) -> int:
    """Texels of an atlas not made yet: as many as pixels ask for, or as there may be."""
    asked = settings.unwrap_atlas
    if asked.size is not None:
        return round(COVERED * asked.size**2)
    finer = (type(asked)().texel_pixels / asked.texel_pixels) ** 2
    return round(min(TEXELS_PER_PIXEL[capture.kind] * capture.pixels * finer, COVERED * asked.most**2))
