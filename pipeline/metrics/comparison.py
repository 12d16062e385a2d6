"""Pictures to look at: captured, rendered, and where they differ."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from pipeline.base.color import srgb_from_linear

ERROR_AT_TOP = 0.2
"""Mean absolute sRGB error that the error picture shows as its brightest colour: 14 dB, a mistake no one overlooks."""

SMALL_SIDE = 512
"""Pictures lower than this, pixels, are enlarged three times, nearest pixel: what is shown is what was scored."""

ENLARGE = 3
LABEL_HEIGHT, BAR_WIDTH, GAP = 22, 64, 6
WHITE = (255, 255, 255)
PANELS = ("captured", "rendered", "error")
PANELS_IN_ROW = 4


def preview_srgb(rgb_linear: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w 3"]:
    """sRGB to look at: clipped to what a display can show, black where there is no number.

    For pictures that are scored see `pipeline.metrics.evaluation.scored_srgb`.
    """
    return np.nan_to_num(srgb_from_linear(np.clip(rgb_linear, 0, 1)).clip(0, 1))


def side_by_side(
    captured: Float[np.ndarray, "h w 3"], rendered: Float[np.ndarray, "h w 3"], label: str
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw captured | rendered | error with its colour bar, under a label.

    sRGB in [0, 1] in, 8-bit sRGB out.
    """
    error = np.abs(rendered - captured).mean(2)
    pictures = [np.round(captured * 255), np.round(rendered * 255), _heat(error / ERROR_AT_TOP)]
    times = ENLARGE if captured.shape[0] < SMALL_SIDE else 1
    panels = [p.astype(np.uint8).repeat(times, 0).repeat(times, 1) for p in pictures]
    gap = np.zeros((panels[0].shape[0], GAP, 3), np.uint8)
    row = np.hstack([panels[0], gap, panels[1], gap, panels[2], _color_bar(panels[0].shape[0])])
    titles = np.zeros((2 * LABEL_HEIGHT, row.shape[1], 3), np.uint8)
    _write(titles, label, (4, LABEL_HEIGHT - 7))
    step = panels[0].shape[1] + GAP
    for i, title in enumerate(PANELS):
        _write(titles, title, (4 + i * step, 2 * LABEL_HEIGHT - 7))
    return np.vstack([titles, row])


def labelled_panels(
    pictures: Mapping[str, Float[np.ndarray, "h w 3"]], label: str
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw pictures in rows of `PANELS_IN_ROW`, each under its title and all under a label.

    sRGB in [0, 1] of one size in, 8-bit sRGB out.
    """
    height, width = next(iter(pictures.values())).shape[:2]
    times = ENLARGE if height < SMALL_SIDE else 1
    cell_height, cell_width = LABEL_HEIGHT + times * height, times * width + GAP
    rows, columns = -(-len(pictures) // PANELS_IN_ROW), min(len(pictures), PANELS_IN_ROW)
    drawn = np.zeros((LABEL_HEIGHT + rows * cell_height, columns * cell_width - GAP, 3), np.uint8)
    _write(drawn, label, (4, LABEL_HEIGHT - 7))
    for place, (title, picture) in enumerate(pictures.items()):
        row, column = divmod(place, PANELS_IN_ROW)
        top, left = LABEL_HEIGHT + row * cell_height, column * cell_width
        _write(drawn, title, (left + 4, top + LABEL_HEIGHT - 7))
        panel = np.round(picture.clip(0, 1) * 255).astype(np.uint8).repeat(times, 0).repeat(times, 1)
        drawn[top + LABEL_HEIGHT : top + cell_height, left : left + panel.shape[1]] = panel
    return drawn


def split_picture(picture: UInt8[np.ndarray, "height width 3"]) -> dict[str, UInt8[np.ndarray, "h w 3"]]:
    """Split a picture of `side_by_side` into captured, rendered and error, by name.

    They have the size at which they were scored.
    """
    row = picture[2 * LABEL_HEIGHT :]
    width = (row.shape[1] - 2 * GAP - BAR_WIDTH) // 3
    panels = [row[:, start : start + width] for start in (0, width + GAP, 2 * (width + GAP))]
    small = [panel[::ENLARGE, ::ENLARGE] for panel in panels]
    grown = [panel.repeat(ENLARGE, 0).repeat(ENLARGE, 1) for panel in small]
    enlarged = all(np.array_equal(a, b) for a, b in zip(grown, panels, strict=True))
    return dict(zip(PANELS, small if enlarged else panels, strict=True))


def heat_css() -> str:
    """CSS gradient of the error picture's colours, from no error to `ERROR_AT_TOP`."""
    stops = _heat(np.linspace(0, 1, 9)[:, None])[:, 0]
    return f"linear-gradient(90deg, {', '.join(f'rgb({r},{g},{b})' for r, g, b in stops)})"


def _heat(share: np.ndarray) -> np.ndarray:
    levels = np.round(255 * np.clip(share, 0, 1)).astype(np.uint8)
    return cv2.applyColorMap(levels, cv2.COLORMAP_INFERNO)[..., ::-1]


def _color_bar(height: int) -> np.ndarray:
    bar = np.zeros((height, BAR_WIDTH, 3), np.uint8)
    bar[:, GAP : GAP + 12] = _heat(np.linspace(1, 0, height)[:, None]).repeat(12, 1)
    for share in (1.0, 0.5, 0.0):
        _write(bar, f"{share * ERROR_AT_TOP:.2f}", (GAP + 16, int(10 + (1 - share) * (height - 14))))
    return bar


def _write(picture: np.ndarray, text: str, corner: tuple[int, int]) -> None:
    cv2.putText(picture, text, corner, cv2.FONT_HERSHEY_SIMPLEX, 0.4, WHITE, 1, cv2.LINE_AA)
