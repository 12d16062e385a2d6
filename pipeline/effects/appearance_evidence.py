"""Evidence for effects of appearance: their worth in decibels of PSNR on training images."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from jaxtyping import Float64

from pipeline.effects.appearance_columns import GLOSS_WIDTHS
from pipeline.effects.appearance_fits import Explained, Gains, decibels
from pipeline.effects.seen_texels import SeenTexels, texel_turns
from pipeline.geometry.texels import Atlas, texel_frames

FOOTPRINT_STD = 0.6
"""Standard deviation of a Gaussian on the surface, in texel spacings: neighbours then sum to an even surface."""


FEWEST_OBSERVATIONS = 200
"""Of a region: with fewer, what holds for the whole subject holds for it."""


@dataclass(frozen=True)
class Evidence:
    """One measured number, and the sentence that says what it is.

    Attributes:
        regions: the same number of each part of the surface, where the template names them.
        unit: of these numbers.
        ggx_width: of gloss, the width that fits it best.
    """

    value: float
    text: str
    regions: Mapping[str, float] = field(default_factory=dict)
    unit: str = "dB"
    ggx_width: float | None = None


def choose_images(
    images: pd.DataFrame, synced: pd.DataFrame, usable: set[int], fully_lit: int, partially_lit: int, cameras: int
) -> pd.DataFrame:
    """Choose training images of a few frames, evenly spread, some fully lit, by a few cameras.

    Args:
        images: of the index: camera, frame, path, test_camera, validation_camera.
        synced: frames.parquet of book_patterns.
        usable: frames that are tracked and have a light on.
    """
    synced = synced.set_index("frame")
    known = images[images.frame.isin(synced.index) & images.frame.isin(usable)]
    held_out = known.test_camera | known.validation_camera
    train = known[~held_out & (known.frame.map(synced.split) == "train")]
    lit = train.frame.map(synced.fully_lit).astype(bool)
    frames = [*spread(train.frame[lit], fully_lit), *spread(train.frame[~lit], partially_lit)]
    chosen = train[train.frame.isin(frames) & train.camera.isin(spread(train.camera, cameras))]
    return chosen.sort_values(["frame", "camera"])


def spread(values: pd.Series, count: int) -> list:
    """At most `count` of the values that occur, evenly spaced in their order."""
    every = sorted(set(values))
    return every if len(every) <= count else [every[int((i + 0.5) * len(every) / count)] for i in range(count)]


def describe(found: Explained) -> str:
    """Text that says what the numbers rest on."""
    return (
        f"{found.observations} colours of texels in training images, {100 * found.strays:.1f} % left out as strays, "
        f"residual {100 * found.floor:.2f} % of full scale"
    )


def judged(gains: Gains, of_region: float, of_whole: float) -> float:
    """Gain of a region, or of the whole subject where too little of the region was seen."""
    return of_region if gains.observations >= FEWEST_OBSERVATIONS else of_whole


def specular_evidence(found: Explained) -> Evidence:
    """Gain by gloss over what colours of texels explain, in dB."""
    regions = {name: judged(gains, gains.gloss_db, found.gloss_db) for name, gains in found.regions.items()}
    text = f"gloss explains {found.gloss_db:.2f} dB of {describe(found)}"
    return Evidence(found.gloss_db, text, regions, ggx_width=gloss_width(found))


def gloss_width(found: Explained) -> float | None:
    """GGX width of the fitted gloss, the mean by how much of each there is; None without."""
    total = found.gloss.sum()
    return float(found.gloss @ GLOSS_WIDTHS / total) if total > 0 else None


def transport_evidence(found: Explained) -> Evidence:
    """Gain by light from below the surface beyond GGX, traced visibility and one bounce, in dB."""
    text = f"beyond GGX, traced visibility and one bounce, light from below explains {found.transport_db:.2f} dB of "
    regions = {name: judged(gains, gains.transport_db, found.transport_db) for name, gains in found.regions.items()}
    return Evidence(found.transport_db, text + describe(found), regions)


def deferred_evidence(
    found: Explained, seen: SeenTexels, atlas: Atlas, spacing_m: Float64[np.ndarray, " t"]
) -> Evidence:
    """Loss by shading per Gaussian in place of per pixel, in dB.

    Interpolating over Gaussians widens a lobe of variance s^2 by that of the mirrored direction over a Gaussian,
    (0.6 x 2 x the turn of the normal from texel to texel)^2, which lowers its peak by that ratio. What a pixel averages
    anyway is not lost: the part (pixel / texel)^2 of it. A GGX of width a has slopes of variance a^2 / 2, and mirrored
    directions turn twice as far: s^2 = 2 a^2.
    """
    normals = texel_frames(atlas, atlas.rest_vertices.astype(np.float64))[1][..., 2]
    texel = seen.texels[seen.point]
    footprint_px = spacing_m[texel] / seen.pixel_m
    turn = 2 * FOOTPRINT_STD * texel_turns(atlas, normals)[texel]
    own = np.maximum(1 - footprint_px**-2.0, 0)
    lost = [np.minimum(turn**2 / (2 * width**2) * own, 1) ** 2 for width in GLOSS_WIDTHS]
    square = float((found.gloss**2) @ np.mean(lost, 1)) if len(texel) else 0.0
    value = decibels(found.floor**2 + square, found.floor**2)
    middle = np.median(footprint_px) if len(texel) else 0.0
    spread_deg = np.degrees(np.median(turn)) if len(texel) else 0.0
    width_deg = np.degrees(np.sqrt(2) * (gloss_width(found) or 0.0))
    text = (
        f"mirrored directions spread by {spread_deg:.1f} degrees over a Gaussian of {middle:.2f} pixels, lobes are "
        f"{width_deg:.0f} degrees wide: shading per Gaussian would lose {value:.2f} dB"
    )
    return Evidence(value, text)
