"""A contact sheet of maps on an atlas, one tile per frame."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float

from pipeline.base.files import written_whole
from pipeline.geometry.texels import Atlas

SHEET_TILES = 12
"""Maps on a sheet, evenly spaced over the frames."""

BACKGROUND = np.array([96, 48, 16], np.uint8)
"""Blue (BGR) where the atlas has no texel: no map is of this colour."""

CAPTION_PX, BORDER_PX = 18, 2


def spread_tiles(count: int) -> list[int]:
    """Numbers of the maps that are shown, of `count`."""
    return sorted({int(index) for index in np.linspace(0, count - 1, min(SHEET_TILES, count))})


def write_atlas_sheet(
    path: Path, atlas: Atlas, tiles: Sequence[tuple[str, Float[np.ndarray, "texels channels"]]]
) -> None:
    """Write a PNG of the tiles, each below its caption.

    Values 0..1 are shown as grey (one channel) or RGB (three).
    """
    outside = atlas.to_map(np.zeros(atlas.texel_count), 1.0) > 0
    drawn = [_tile(caption, atlas.to_map(values.T), outside) for caption, values in tiles]
    across = int(np.ceil(np.sqrt(len(drawn))))
    drawn += [np.full_like(drawn[0], 255)] * (-len(drawn) % across)
    sheet = cv2.vconcat([cv2.hconcat(drawn[i : i + across]) for i in range(0, len(drawn), across)])
    with written_whole(path) as temporary:
        temporary.write_bytes(cv2.imencode(".png", sheet)[1].tobytes())


def _tile(caption: str, channels: np.ndarray, outside: np.ndarray) -> np.ndarray:
    bgr = np.clip(channels[::-1].transpose(1, 2, 0) * 255, 0, 255).astype(np.uint8)
    tile = np.where(outside[..., None], BACKGROUND, bgr)
    white = (255, 255, 255)
    edges = (CAPTION_PX, BORDER_PX, BORDER_PX, BORDER_PX)
    tile = cv2.copyMakeBorder(tile, *edges, cv2.BORDER_CONSTANT, value=white)
    return cv2.putText(tile, caption, (4, 13), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (0, 0, 0), 1, cv2.LINE_AA)
