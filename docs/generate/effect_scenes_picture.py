"""Draw docs/pictures/effect_scenes.jpg: the scenes that planned effects are held against everything on in.

    python -m docs.generate.effect_scenes_picture

One picture of each scene of `benchmarks.effect_scenes`, under a few of its lamps, drawn and photographed as
`benchmarks.bench_effects` does but with fewer cameras and frames. Takes some minutes.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import cv2
import numpy as np
import tyro
from jaxtyping import UInt8

from benchmarks.bench_effects import DRAWS, LARGE
from benchmarks.effect_scenes import SCENES, make_scene
from docs.generate.pictures import JPEG_QUALITY, composed, enlarged
from pipeline.base.code_digest import ROOT
from pipeline.capture.images import read_image
from pipeline.metrics.comparison import preview_srgb

FEW = {"cameras": 2, "test_cameras": 1, "frames": 3, "frames_b": 1, "test_frames": 1}
PARTIALLY_LIT = "000001.exr"
IN_ROW, WIDTH = 5, 1300
"""Scenes side by side, and pixels of a row."""


def run(*, out: Path = ROOT / "docs/pictures/effect_scenes.jpg") -> None:
    """Write the picture.

    Args:
        out: file to write.
    """
    names = list(SCENES)
    rows = [names[start : start + IN_ROW] for start in range(0, len(names), IN_ROW)]
    drawn = np.vstack([composed([enlarged(photographed(name)) for name in row], row) for row in rows])
    shown = cv2.resize(drawn, (WIDTH, round(WIDTH * drawn.shape[0] / drawn.shape[1])), interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(out), shown[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    print(f"{out}: {out.stat().st_size / 1e3:.0f} kB")


def photographed(name: str) -> UInt8[np.ndarray, "h w 3"]:
    """A scene, seen by its first camera."""
    with tempfile.TemporaryDirectory() as folder:
        capture = make_scene(Path(folder), name, 16, DRAWS["report"], **LARGE, **FEW)["capture"]
        first = min((capture / "images").iterdir())
        return np.round(255 * preview_srgb(read_image(first / PARTIALLY_LIT))).astype(np.uint8)


if __name__ == "__main__":
    tyro.cli(run)
