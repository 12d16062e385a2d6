"""Random numbers that decide which light a texel draws.

Spread over the map so that neighbours err in different ways.

Every texel's number is uniform in [0, 1) on its own, whatever the pattern, so every estimate stays unbiased; only how
the errors of neighbours hang together differs, which is what a blur, or a network that looks at the map, sees.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from jaxtyping import Float64, Int

from pipeline.lighting.ray_kernels import lattice_numbers

SamplePattern = Literal["random", "stratified", "low_discrepancy"]

BLOCK = 4
"""Side of the blocks of texels that share one stratified draw: 16 strata, as many as a glance at the map averages."""

PLASTIC = 1.324717957244746
"""Real root of x^3 = x + 1: its powers give the two-dimensional sequence of lowest known discrepancy (Roberts 2018)."""


def pattern_uniforms(
    pattern: SamplePattern, texel: Int[np.ndarray, "t 2"], random: np.random.Generator
) -> Float64[np.ndarray, " t"]:
    """Draw one number in [0, 1) per texel.

    Args:
        pattern: random: independent; stratified: each of a block's 16 texels in another sixteenth, in random order;
            low_discrepancy: a lattice over rows and columns, shifted at random as a whole (Cranley and Patterson 1976).
        texel: row and column of each texel.
    """
    if pattern == "random":
        return random.random(len(texel))
    if pattern == "low_discrepancy":
        uniform = np.empty(len(texel))
        lattice_numbers(texel, 1 / PLASTIC**2, 1 / PLASTIC, random.random(), uniform)
        return uniform
    rows, columns = texel.max(0, initial=0) // BLOCK + 1
    order = random.permuted(np.tile(np.arange(BLOCK**2), (rows * columns, 1)), axis=1)
    block, place = texel // BLOCK @ [columns, 1], texel % BLOCK @ [BLOCK, 1]
    # Below 1 also where the sum rounds up.
    return np.minimum((order[block, place] + random.random(len(texel))) / BLOCK**2, np.nextafter(1, 0))
