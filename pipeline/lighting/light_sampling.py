"""Random numbers that decide which light a texel draws.

Spread over the map so that neighbours err in different ways.

Every texel's number is uniform in [0, 1) on its own, whatever the pattern, so every estimate stays unbiased; only how
the errors of neighbours hang together differs, which is what a blur, or a network that looks at the map, sees.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float64, Int

from pipeline.lighting.draw_kernels import STEPS, lattice_numbers

SamplePattern = Literal["random", "stratified", "low_discrepancy"]

Sampling = Literal["uniform", "power", "arriving"]
"""Probability of a light: the same for all; by luminance; by what would arrive at the point unoccluded."""

BLOCK = 4
"""Side of the blocks of texels that share one stratified draw: 16 strata, as many as a glance at the map averages."""

NO_SHIFT = np.uint32(0)


@dataclass(frozen=True)
class Uniforms:
    """Numbers in [0, 1), one per texel.

    Attributes:
        numbers: the numbers; or empty: a texel's place in the lattice tells its own.
        shift: of the lattice, in steps of 2^-32.
    """

    numbers: Float64[np.ndarray, " t"]
    shift: np.uint32 = NO_SHIFT


def pattern_uniforms(pattern: SamplePattern, texel: Int[np.ndarray, "t 2"], random: np.random.Generator) -> Uniforms:
    """Draw one number in [0, 1) per texel.

    Args:
        pattern: random: independent; stratified: each of a block's 16 texels in another sixteenth, in random order;
            low_discrepancy: a lattice over rows and columns, shifted at random as a whole (Cranley and Patterson 1976).
        texel: row and column of each texel.
    """
    if pattern == "random":
        return Uniforms(random.random(len(texel)))
    if pattern == "low_discrepancy":
        return Uniforms(np.empty(0), np.uint32(random.random() * STEPS))
    rows, columns = texel.max(0, initial=0) // BLOCK + 1
    order = random.permuted(np.tile(np.arange(BLOCK**2), (rows * columns, 1)), axis=1)
    block, place = texel // BLOCK @ [columns, 1], texel % BLOCK @ [BLOCK, 1]
    # Below 1 also where the sum rounds up.
    return Uniforms(np.minimum((order[block, place] + random.random(len(texel))) / BLOCK**2, np.nextafter(1, 0)))


def pattern_numbers(
    pattern: SamplePattern, texel: Int[np.ndarray, "t 2"], random: np.random.Generator
) -> Float64[np.ndarray, " t"]:
    """The numbers of `pattern_uniforms`, those of the lattice made, too."""
    drawn = pattern_uniforms(pattern, texel, random)
    if len(drawn.numbers) == len(texel):
        return drawn.numbers
    uniform = np.empty(len(texel))
    lattice_numbers(texel, drawn.shift, uniform)
    return uniform
