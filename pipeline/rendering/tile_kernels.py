"""Lists of the Gaussians that touch each tile, front to back."""

from __future__ import annotations

import numpy as np

from pipeline.base.kernel_cache import kernel


def depth_order(depth: np.ndarray, visible: np.ndarray) -> np.ndarray:
    """Indices of the visible Gaussians by depth rounded to float32, ties by index.

    Depths are positive, so their bits sort like the numbers: depth above index in one integer makes the order unique
    whatever sort is used.
    """
    index = np.flatnonzero(visible)
    keys = depth[index].astype(np.float32).view(np.uint32).astype(np.uint64) << np.uint64(32)
    keys |= index.astype(np.uint64)
    keys.sort()
    return (keys & np.uint64(0xFFFFFFFF)).astype(np.int64)


@kernel()
def list_tiles(order, tiles, tiles_across, tiles_down):
    """Lists of Gaussians per tile, in the given order.

    Args:
        order: visible Gaussians front to back.
        tiles: [g, 4] first and last tile column, first and last tile row.

    Returns:
        tile_start: [tiles + 1], tile k owns entries[tile_start[k] : tile_start[k + 1]].
        entries: Gaussian indices.
        slot_start: [g + 1], Gaussian g owns slots slot_start[g] .. slot_start[g + 1], its tiles row by row.
    """
    tile_start = np.zeros(tiles_across * tiles_down + 1, np.int64)
    slot_start = np.zeros(tiles.shape[0] + 1, np.int64)
    for g in range(tiles.shape[0]):
        slot_start[g + 1] = slot_start[g] + (tiles[g, 1] - tiles[g, 0] + 1) * (tiles[g, 3] - tiles[g, 2] + 1)
        for row in range(tiles[g, 2], tiles[g, 3] + 1):
            for column in range(tiles[g, 0], tiles[g, 1] + 1):
                tile_start[row * tiles_across + column + 1] += 1
    for k in range(tiles_across * tiles_down):
        tile_start[k + 1] += tile_start[k]
    entries = np.empty(tile_start[-1], np.int32)
    end = tile_start[:-1].copy()
    for g in order:
        for row in range(tiles[g, 2], tiles[g, 3] + 1):
            for column in range(tiles[g, 0], tiles[g, 1] + 1):
                k = row * tiles_across + column
                entries[end[k]] = g
                end[k] += 1
    return tile_start, entries, slot_start
