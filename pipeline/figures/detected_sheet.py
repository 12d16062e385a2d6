"""Pictures of landmarks and masks on the photographs that they were found in."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from jaxtyping import UInt8

from pipeline.base.color import srgb_from_linear
from pipeline.base.spread import evenly
from pipeline.capture.images import read_mask, write_png
from pipeline.detection.photographs import Photographs, exposed

MOST_TILES, COLUMNS = 12, 4
"""Images of a sheet, and how many stand side by side."""

TILE = 360
"""Width and height of a tile, pixels."""

SURE, UNSURE, OUTLINE = (0, 158, 115), (213, 94, 0), (230, 159, 0)
"""Colours that colour-blind eyes tell apart: points above and below a confidence of a half, and outlines."""


def draw_landmarks(path: Path, photographs: Photographs, table: pd.DataFrame) -> None:
    """Write a sheet of images, evenly chosen, with their keypoints as dots.

    Args:
        table: frame, camera, x, y (image pixels), confidence.
    """
    tiles = []
    for row in evenly(list(photographs.images.itertuples()), MOST_TILES):
        tile, scale = _tile(photographs, row.path, row.frame)
        mine = table[(table["camera"] == row.camera) & (table["frame"] == row.frame)]
        for point in mine.itertuples():
            at = (round(point.x * scale), round(point.y * scale))
            cv2.circle(tile, at, 3, SURE if point.confidence >= 0.5 else UNSURE, -1, cv2.LINE_AA)
        tiles.append(_titled(tile, f"{row.camera} {row.frame}: {len(mine)}"))
    _write_sheet(path, tiles)


def draw_masks(path: Path, photographs: Photographs, table: pd.DataFrame, folder: Path) -> None:
    """Write a sheet of images, evenly chosen, with the outlines of their masks.

    Args:
        table: camera, frame, mask_path below `folder`.
    """
    paths, tiles = table.set_index(["camera", "frame"])["mask_path"], []
    for row in evenly(list(photographs.images.itertuples()), MOST_TILES):
        tile, scale = _tile(photographs, row.path, row.frame)
        if (row.camera, row.frame) in paths.index:
            mask = cv2.resize(read_mask(folder / paths[(row.camera, row.frame)]), None, fx=scale, fy=scale)
            outlines, _ = cv2.findContours((mask > 127).astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
            cv2.drawContours(tile, outlines, -1, OUTLINE, 1, cv2.LINE_AA)
        tiles.append(_titled(tile, f"{row.camera} {row.frame}"))
    _write_sheet(path, tiles)


def _tile(photographs: Photographs, path: str, frame: int) -> tuple[UInt8[np.ndarray, "h w 3"], float]:
    """An image as it is shown, and its scale."""
    image = photographs.source.read(path, frame)
    scale = TILE / max(image.shape[:2])
    sized = cv2.resize(exposed(image), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return np.round(255 * srgb_from_linear(sized)).astype(np.uint8), scale


def _titled(tile: np.ndarray, title: str) -> UInt8[np.ndarray, "h w 3"]:
    square = np.zeros((TILE, TILE, 3), np.uint8)
    square[: tile.shape[0], : tile.shape[1]] = tile[:TILE, :TILE]
    cv2.putText(square, title, (6, TILE - 8), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 1, cv2.LINE_AA)
    return square


def _write_sheet(path: Path, tiles: list[np.ndarray]) -> None:
    across = min(COLUMNS, max(len(tiles), 1))
    empty = np.zeros((TILE, TILE, 3), np.uint8)
    rows = [tiles[at : at + across] for at in range(0, len(tiles), across)] or [[empty]]
    rows[-1] = rows[-1] + [empty] * (across - len(rows[-1]))
    write_png(path, np.concatenate([np.concatenate(row, 1) for row in rows]))
