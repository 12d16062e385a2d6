"""How a chunk is refined by its images: which frames, at which blurs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Int64

from pipeline.base.files import read_table
from pipeline.geometry.mesh import weld_vertices
from pipeline.geometry.skin import Template
from pipeline.geometry.surface_points import spread_points
from pipeline.lighting.frame_lights import NO_LIGHTS, FrameLights
from pipeline.tracking.color_views import ColorView, evenly
from pipeline.tracking.cues import Cue, Rounds
from pipeline.tracking.image_cue import ImageCue
from pipeline.tracking.keyframe_refinement import Refinement

BLURS_PX = (2.0, 1.0)
"""Coarse, then fine: a colour edge is felt from about twice the blur away, and blur beyond a limb's width erases it."""

ROUNDS_BETWEEN = 2
"""Rounds of outlines for the frames between refined ones: they start from carried poses, a millimetre away."""


def fully_lit_frames(patterns: Path, frames: Int64[np.ndarray, " frames"], most: int) -> Int64[np.ndarray, " lit"]:
    """Positions in `frames` of those that `patterns` calls fully lit: at most so many, evenly chosen."""
    table = read_table(patterns)
    lit = np.flatnonzero(np.isin(frames, table.frame[table.fully_lit]))
    return np.array(evenly(lit.tolist(), most), np.int64)


def image_refinement(
    template: Template, views: Sequence[ColorView], lights: Mapping[int, FrameLights],
    frames: Int64[np.ndarray, " frames"], lit: Int64[np.ndarray, " lit"], outlines: Sequence[Cue],
    *, rounds: int, points: int, redundancy: float, offset_m: float,
) -> Refinement:  # fmt: skip
    """Rounds of comparing colours, with `outlines` kept, for the `lit` ones of `frames`."""
    surface = spread_points(template.vertices_rest, template.faces, points)
    weld = weld_vertices(template.vertices_rest, template.faces)
    per_frame = [lights.get(int(frame), NO_LIGHTS) for frame in frames]
    schedule = []
    for blur in BLURS_PX:
        blurred = [view.blurred(blur) for view in views]
        cue = ImageCue(surface, template.faces, weld, blurred, per_frame, redundancy)
        schedule.append(Rounds(f"images blurred by {blur:g} px", [*outlines, cue], rounds))
    return Refinement(lit, schedule, [Rounds("between refined frames", outlines, ROUNDS_BETWEEN)], offset_m)
