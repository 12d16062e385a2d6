"""Standard error of an estimated irradiance map, told from its samples alone.

A single draw says nothing of its own variance, so it is taken from the same draw of the texels in a small block around
it. With several stratified draws per texel this is done stratum by stratum, and the variance of their mean is the sum
over N^2 (Cochran 1977, 5.2): how the strata differ from each other, which adds no error, stays out of it. Changes of
the true value from texel to texel count as noise, so the error stated is rather too large than too small.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32, Float64, Int

from pipeline.lighting.draw_kernels import add_block_variances, add_variances_of_sums, spread_over_blocks

BLOCK_BITS = 2
BLOCK = 1 << BLOCK_BITS
"""Side of the blocks of texels that share an estimate: 16 numbers, whose deviation is good to 18 %."""


class TexelBlocks:
    """Blocks of a map that texels lie in: the same for all frames."""

    def __init__(self, texel: Int[np.ndarray, "t 2"]) -> None:
        """Args:
        texel: row and column of each texel on the map.
        """
        self.texel = texel
        row, column = texel.T >> BLOCK_BITS
        self.block = (row * (column.max(initial=0) + 1) + column).astype(np.uint32)
        self.count = np.bincount(self.block).astype(np.float64)


class BlockVariance:
    """Sum over draws of the variance among the texels of each block.

    Attributes:
        total: the sum, per block.
    """

    def __init__(self, blocks: TexelBlocks) -> None:
        self._blocks = blocks
        self.total = np.zeros(len(blocks.count))

    def add(self, draws: Float64[np.ndarray, " t"]) -> None:
        """Add one draw of every texel."""
        add_block_variances(draws, self._blocks.block, self._blocks.count, self.total)

    def add_sums(self, sums: Float64[np.ndarray, " b"], squares: Float64[np.ndarray, " b"]) -> None:
        """Add one draw of every texel, of which the sum and the sum of squares are known per block.

        Rounding can leave a few 1e-8 of the largest draw where all are the same.
        """
        add_variances_of_sums(sums, squares, self._blocks.count, self.total)

    def error_of_mean(self, draws: int) -> Float32[np.ndarray, " t"]:
        """Standard error of the mean of that many draws, per texel."""
        error = np.empty(len(self._blocks.block), np.float32)
        spread_over_blocks((np.sqrt(self.total) / draws).astype(np.float32), self._blocks.block, error)
        return error
