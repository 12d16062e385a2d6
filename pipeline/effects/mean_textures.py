"""Mean textures: average colours of texels over the cameras that see them, fully lit."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float32, Float64, Int64
from scipy.spatial import cKDTree

from pipeline.capture.images import ImageSource
from pipeline.effects.seen_texels import observe_texels
from pipeline.geometry.cameras import Camera
from pipeline.geometry.pose_interpolation import neighbours
from pipeline.geometry.texels import Atlas

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class SeenColors:
    """Mean colours that the images of one frame show of the texels.

    Attributes:
        mean: linear RGB; zero where a texel is not seen.
        weight: sum over the cameras that see it of cos^p between normal and view; zero where none does.
    """

    mean: Float64[np.ndarray, "texels 3"]
    weight: Float64[np.ndarray, " texels"]


def seen_colors(
    source: ImageSource, images: pd.DataFrame, cameras: Mapping[str, Camera],
    colors: Mapping[str, Float64[np.ndarray, "3 columns"]], atlas: Atlas, vertices: Float32[np.ndarray, "v 3"],
    cosine_power: float,
) -> SeenColors:  # fmt: skip
    """Mean over some images of one frame, each texel weighted by visibility x cos^p.

    Only where a texel is seen well (`pipeline.effects.seen_texels`): not at grazing angles, not beside what hides it,
    and not where a pixel is clipped. An image in which all that is seen is black shows no light, not a black subject:
    it is left out with a warning. Parameters as in `observe_texels`.
    """
    total, weight = np.zeros((atlas.texel_count, 3)), np.zeros(atlas.texel_count)
    every = np.arange(atlas.texel_count)
    for row in range(len(images)):
        image = images.iloc[row : row + 1]
        posed = {int(image.frame.iloc[0]): vertices}
        # Image by image: all observations of a large atlas at once would not fit in memory.
        seen = observe_texels(source, image, cameras, colors, atlas, every, posed)
        if len(seen.point) and not (seen.color > 0).any():
            log.warning("%s: all that is seen of the subject is black; left out", image.path.iloc[0])
            continue
        share = (seen.normals[0, seen.point] * seen.to_camera).sum(1) ** cosine_power
        total[seen.point] += share[:, None] * seen.color
        weight[seen.point] += share
    return SeenColors(_divided(total, weight), weight)


def joined(found: Sequence[SeenColors]) -> SeenColors:
    """Mean colours of several frames together."""
    weight = np.sum([colors.weight for colors in found], axis=0)
    total = np.sum([colors.weight[:, None] * colors.mean for colors in found], axis=0)
    return SeenColors(_divided(total, weight), weight)


def fill_unseen(
    found: Sequence[SeenColors], places: Float64[np.ndarray, "texels 3"]
) -> Float64[np.ndarray, "frames texels 3"]:
    """Mean colours, with something for texels that no camera sees in a frame.

    They get their own mean colour over all frames, and where none shows them, that of the nearest texel (by `places`)
    that is seen in one; black if nothing is seen at all.
    """
    typical = joined(found)
    seen, instead = typical.weight > 0, typical.mean.copy()
    if seen.any() and not seen.all():
        instead[~seen] = typical.mean[seen][cKDTree(places[seen]).query(places[~seen])[1]]
    return np.stack([np.where(colors.weight[:, None] > 0, colors.mean, instead) for colors in found])


def _divided(total: np.ndarray, weight: np.ndarray) -> np.ndarray:
    return np.divide(total, weight[:, None], out=np.zeros_like(total), where=weight[:, None] > 0)


def between_lit_frames(
    textures: Float64[np.ndarray, "lit texels 3"], lit: Bool[np.ndarray, " frames"],
    takes: Int64[np.ndarray, " frames"],
) -> Float64[np.ndarray, "frames texels 3"]:  # fmt: skip
    """Textures of all frames, linear between fully lit neighbours of the same take (RGCA 3)."""
    before, after, share = neighbours(np.flatnonzero(lit).astype(np.int64), len(lit), takes)
    later = share[:, None, None]
    return (1 - later) * textures[before] + later * textures[after]
