"""Pictures of charts that were refused, and of which patches show what they should."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64

from pipeline.base.color import srgb_from_linear
from pipeline.capture.images import write_png

LONGER_SIDE = 900
"""Of the picture, pixels."""

FITTING, ODD, UNUSED = (0, 158, 115), (213, 94, 0), (150, 150, 150)
"""Outlines of patches that fit, that do not, and that are saturated or too small; told apart by colour-blind eyes."""

WHITE_PERCENTILE = 99.5
"""Brightness that is shown as white."""


def draw_refused_chart(
    path: Path, image: Float32[np.ndarray, "h w 3"], squares: Float64[np.ndarray, "patches 4 2"] | None,
    used: Bool[np.ndarray, " patches"], fits: Bool[np.ndarray, " patches"],
) -> None:  # fmt: skip
    """Write the image with the outline of each measured square.

    Those that do not fit are crossed out.

    Args:
        image: linear RGB.
        squares: in the order of the chart, image pixels; None if no chart was found.
        used: neither saturated nor too small.
        fits: show the chart's colour.
    """
    scale = LONGER_SIDE / max(image.shape[:2])
    sized = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    white = max(float(np.percentile(sized, WHITE_PERCENTILE)), 1e-12)
    shown = np.round(np.clip(srgb_from_linear(np.clip(sized / white, 0, 1)), 0, 1) * 255).astype(np.uint8)
    for number, square in enumerate(() if squares is None else squares, 1):
        # From the corner of the first pixel to OpenCV's pixel centres.
        corners = np.round(square * scale - 0.5).astype(np.int32)
        color = UNUSED if not used[number - 1] else FITTING if fits[number - 1] else ODD
        cv2.polylines(shown, [corners], isClosed=True, color=color, thickness=3, lineType=cv2.LINE_AA)
        if color != FITTING:
            for a, b in ((0, 2), (1, 3)):
                cv2.line(shown, corners[a].tolist(), corners[b].tolist(), color, 2, cv2.LINE_AA)
        at = (int(corners[:, 0].min()), int(corners[:, 1].min()) - 4)
        for thickness, ink in ((3, (255, 255, 255)), (1, (0, 0, 0))):
            cv2.putText(shown, str(number), at, cv2.FONT_HERSHEY_SIMPLEX, 0.45, ink, thickness, cv2.LINE_AA)
    write_png(path, shown)
