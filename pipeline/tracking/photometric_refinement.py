"""Photometric refinement of a chunk: fully lit frames and rounds of comparing colours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Int64

from pipeline.base.files import read_table
from pipeline.base.spread import evenly
from pipeline.geometry.mesh import weld_vertices
from pipeline.geometry.skin import Template
from pipeline.geometry.surface_points import spread_points
from pipeline.lighting.frame_lights import NO_LIGHTS, FrameLights
from pipeline.tracking.color_views import ColorView
from pipeline.tracking.cues import Cue, Rounds
from pipeline.tracking.image_cue import ImageCue
from pipeline.tracking.keyframe_refinement import KeyframeRefinement

BLURS_PX = (2.0, 1.0)
"""Coarse, then fine: a colour edge is felt from about twice the blur away, and blur beyond a limb's width erases it."""

ROUNDS_BETWEEN = 2
"""Rounds of silhouettes for the frames between keyframes: they start from interpolated poses, a millimetre away."""


def fully_lit_frames(patterns: Path, frames: Int64[np.ndarray, " frames"], most: int) -> Int64[np.ndarray, " lit"]:
    """Positions in `frames` of fully lit ones, at most so many, evenly chosen.

    Args:
        patterns: patterns.parquet of book_patterns, which says which frames are fully lit.
    """
    table = read_table(patterns)
    lit = np.flatnonzero(np.isin(frames, table.frame[table.fully_lit]))
    return np.array(evenly(lit.tolist(), most), np.int64)


@dataclass(frozen=True)
class PhotometricSettings:
    """Settings of comparing colours; see `pipeline.config.track_mesh`.

    Attributes:
        rounds: of each blur, at most.
        points: of the surface whose colours are compared.
        redundancy: how many samples count as one.
        offset_m: typical offset of a vertex from the posed template; 0: none.
    """

    rounds: int
    points: int
    redundancy: float
    offset_m: float


def photometric_refinement(
    template: Template, views: Sequence[ColorView], lights: Mapping[int, FrameLights],
    frames: Int64[np.ndarray, " frames"], lit: Int64[np.ndarray, " lit"], silhouettes: Sequence[Cue],
    settings: PhotometricSettings,
) -> KeyframeRefinement:  # fmt: skip
    """Rounds of comparing colours, with `silhouettes` kept, for the `lit` ones of `frames`."""
    surface = spread_points(template.vertices_rest, template.faces, settings.points)
    weld = weld_vertices(template.vertices_rest, template.faces)
    per_frame = [lights.get(int(frame), NO_LIGHTS) for frame in frames]
    schedule = []
    for blur in BLURS_PX:
        blurred = [view.blurred(blur) for view in views]
        cue = ImageCue(surface, template.faces, weld, blurred, per_frame, settings.redundancy)
        schedule.append(Rounds(f"images blurred by {blur:g} px", [*silhouettes, cue], settings.rounds))
    between = Rounds("between keyframes", silhouettes, ROUNDS_BETWEEN)
    return KeyframeRefinement(lit, schedule, [between], settings.offset_m)
