"""Pictures of flat prints, a board or a chart, under even light.

Such a print's radiance is its texture, so its pinhole image is the texture under a homography (Hartley and Zisserman
2004, section 8.1.1): no path is traced. Samples lie on a regular grid, which leaves less error at edges than as many
random ones.
"""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float32, Float64

from pipeline.base.conventions import PIXEL_CENTER
from pipeline.synthesis.lens import LensView

GRID = 3
"""Samples per fine pixel along one axis.

Their error is a third of that of four low-discrepancy samples (benchmarks/bench_synthesis.py).
"""


def render_print(
    texture: Float32[np.ndarray, "h w channels"], corners: Float64[np.ndarray, "4 3"], view: LensView, grid: int = GRID
) -> Float32[np.ndarray, "crop_height crop_width channels"]:
    """Render a view's window of a print whose radiance is its texture; zero beside the print.

    Args:
        texture: linear, up to four channels, row 0 at the top edge; looked up without interpolation.
        corners: metres: top left, top right, bottom right, bottom left as seen from the front, which the camera sees.
    """
    x, y, width, height = view.crop
    in_camera = corners @ view.camera.R.T + view.camera.t
    on_film = view.focal * in_camera[:, :2] / in_camera[:, 2:] + np.array(view.film) / 2 - [x, y]
    rows, columns = texture.shape[:2]
    in_texture = np.array([[0, 0], [columns, 0], [columns, rows], [0, rows]])
    # OpenCV counts from the centres of texels and samples.
    texture_from_sample = cv2.getPerspectiveTransform(
        (grid * on_film - PIXEL_CENTER).astype(np.float32), (in_texture - PIXEL_CENTER).astype(np.float32)
    )
    samples = cv2.warpPerspective(
        texture, texture_from_sample, (grid * width, grid * height), flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
    )
    return cv2.resize(samples, (width, height), interpolation=cv2.INTER_AREA).reshape(height, width, -1)
