"""Texels of each part of a surface that a template names, every texel in one of them."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from jaxtyping import Bool, Int64

from pipeline.geometry.texels import Atlas

REST = "rest"
"""What no region names."""

INSIDE = 0.5
"""Share of a texel above which it lies in a region."""


def texels_by_region(atlas: Atlas) -> dict[str, Int64[np.ndarray, " _"]]:
    """Ascending texels of each region, and of the rest.

    Of regions that overlap, as a face lies in a head, the smaller one has the texel. Nothing where no region is known.
    """
    left, found = np.ones(atlas.texel_count, bool), {}
    for name in sorted(atlas.regions, key=lambda name: (len(atlas.regions[name]), name)):
        inside = left & (atlas.texels_of(name) > INSIDE)
        found[name], left = np.flatnonzero(inside), left & ~inside
    return {name: texels for name, texels in (found | {REST: np.flatnonzero(left)}).items() if found and len(texels)}


def in_regions(atlas: Atlas, names: Collection[str]) -> Bool[np.ndarray, " t"]:
    """The texels of these regions.

    Raises:
        KeyError: if the atlas does not know one of them.
    """
    inside, found = np.zeros(atlas.texel_count, bool), texels_by_region(atlas)
    for name in names:
        inside[found[name]] = True
    return inside
