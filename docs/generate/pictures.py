"""Compose the README's pictures of a subject: captured | rendered | relit by lamps | relit by a sky.

    python -m docs.generate.pictures --results results/subjectA

Reads the picture of median PSNR that evaluate_avatar wrote, so nobody chose it, and renders the same frame from the
same camera under two lights that this module makes. Writes docs/pictures/SUBJECT.jpg.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import tyro
from jaxtyping import Float32, UInt8

from pipeline.base.code_digest import ROOT
from pipeline.base.files import read_table
from pipeline.capture.records import ImageRecord
from pipeline.capture.shards import read_image_shards
from pipeline.config.flags import flags
from pipeline.config.relight_avatar import RelightAvatar
from pipeline.metrics.comparison import split_picture
from pipeline.metrics.evaluation import worst_median_best

HEIGHT = 400
"""Height of each panel, pixels: four panels are as wide as a README page."""

GAP = 8
TITLE_HEIGHT = 28
JPEG_QUALITY = 88
PANELS = ("captured", "rendered", "relit: two lamps", "relit: evening sky")

FINER = 2
"""Pixels of a relit picture per captured pixel, along a side: an avatar may be shown finer than it was trained."""

SKY_HEIGHT = 64
SUN_RADIANCE = np.array([90.0, 52.0, 24.0])
ZENITH, HORIZON, GROUND = np.array([0.18, 0.32, 0.75]), np.array([0.95, 0.62, 0.42]), np.array([0.14, 0.11, 0.09])


def run(*, results: Path, variant: str = "full", out: Path = ROOT / "docs/pictures") -> None:
    """Write the picture of one subject.

    Args:
        results: folder results/SUBJECT of a finished run.
        variant: the avatar that is shown.
        out: folder for SUBJECT.jpg.
    """
    scores = read_table(results / "metrics_per_image.parquet")
    median = worst_median_best(scores[scores.variant == variant])["median"]
    stored = cv2.imread(str(results / f"images/{variant}_median.png"))
    shown = split_picture(stored[..., ::-1])
    panels = [enlarged(shown["captured"]), enlarged(shown["rendered"])]
    crop = read_image_shards(sorted((results / "shards/test").glob("*.arrow")))[int(median["index"])]
    with tempfile.TemporaryDirectory() as name:
        for light in (lamps(Path(name), distance_of(results)), sky(Path(name))):
            panels.append(relit(results, variant, light, crop, Path(name) / light.stem))
    out.mkdir(parents=True, exist_ok=True)
    file = out / f"{median.subject}.jpg"
    cv2.imwrite(str(file), composed(panels)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    print(f"{file}: camera {median.camera}, frame {median.frame}, {file.stat().st_size / 1e3:.0f} kB")


def distance_of(results: Path) -> float:
    """Median distance of the stage's lights from the stage's centre, metres."""
    lights = read_table(results / "calibration/lights.parquet")
    return float(np.median(np.linalg.norm(lights[["x", "y", "z"]].to_numpy(), axis=1)))


def lamps(folder: Path, distance_m: float) -> Path:
    """A warm lamp from the upper left and a blue one from behind, as far away as the stage's own."""
    rows = []
    for light, direction, rgb in (
        ("key", (-0.75, 0.45, 0.6), (7.0, 5.2, 3.6)),
        ("rim", (0.8, 0.35, -0.5), (2.2, 4.0, 8.0)),
    ):
        place = distance_m * np.array(direction) / np.linalg.norm(direction)
        rows.append((light, *place, *(distance_m**2 * np.array(rgb))))
    path = folder / "lamps.csv"
    pd.DataFrame(rows, columns=["light", "x", "y", "z", "r", "g", "b"]).to_csv(path, index=False)
    return path


def sky(folder: Path) -> Path:
    """A panorama of an evening: blue above, orange at the horizon, a low sun on the right, dark ground."""
    radiance = evening()
    path = folder / "sky.hdr"
    cv2.imwrite(str(path), radiance[..., ::-1])
    return path


def evening() -> Float32[np.ndarray, "height width 3"]:
    """Its radiance: equirectangular, y up, the left edge along -z (`pipeline.lighting.environment`)."""
    polar = np.pi * (np.arange(SKY_HEIGHT) + 0.5)[:, None] / SKY_HEIGHT
    around = 2 * np.pi * (np.arange(2 * SKY_HEIGHT) + 0.5)[None] / (2 * SKY_HEIGHT)
    x, y, z = np.sin(polar) * np.sin(around), np.cos(polar) + 0 * around, -np.sin(polar) * np.cos(around)
    above = np.clip(y, 0, 1)[..., None] ** 0.6
    radiance = np.where(y[..., None] > 0, (1 - above) * HORIZON + above * ZENITH, GROUND)
    sun = np.array([0.75, 0.3, 0.6]) / np.linalg.norm([0.75, 0.3, 0.6])
    near = np.exp(40.0 * (np.stack([x, y, z], -1) @ sun - 1))[..., None]
    return (1.5 * radiance + near * SUN_RADIANCE / 5).astype(np.float32)


def relit(
    results: Path, variant: str, light: Path, crop: ImageRecord, out: Path, finer: int = FINER
) -> UInt8[np.ndarray, "height width 3"]:
    """The same crop of the same frame, from the same camera, under another light, with `finer` pixels for one."""
    chunks = sorted((results / "tracking").glob("*.safetensors"))
    textures = sorted((results / "textures").glob("*.safetensors"))
    images = read_table(results / "index/cameras.parquet").set_index("camera")
    inputs = {
        "atlas": [results / "atlas.safetensors"],
        "avatar": [results / "avatars" / variant],
        "tracking": chunks,
        "textures": textures,
        "index": [results / "index"],
        "cameras": [results / "calibration/cameras.json"],
        "lights" if light.suffix == ".csv" else "environment": [light],
        "out": [out],
    }
    settings = RelightAvatar(
        first_frame=crop.frame, last_frame=crop.frame, pictures=1, camera_names=(crop.camera,),
        height=finer * int(images.height[crop.camera]), stills="png", splats="none", background="black",
    )  # fmt: skip
    words = [word for flag, paths in inputs.items() if paths for word in (f"--{flag}", *map(str, paths))]
    command = [sys.executable, "-m", "pipeline.stages.relight_avatar", *words, *flags(settings)]
    subprocess.run(command, check=True, cwd=ROOT)
    whole = cv2.imread(str(out / "stills/000000.png"))[..., ::-1]
    left, top, width, height = (finer * edge for edge in (crop.x0, crop.y0, crop.width, crop.height))
    return enlarged(whole[top : top + height, left : left + width])


def enlarged(picture: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "height width 3"]:
    """A picture at the height of a panel, cubic between pixels."""
    width = round(HEIGHT * picture.shape[1] / picture.shape[0])
    return cv2.resize(np.ascontiguousarray(picture), (width, HEIGHT), interpolation=cv2.INTER_CUBIC)


def composed(
    panels: Sequence[UInt8[np.ndarray, "h w 3"]], titles: Sequence[str] = PANELS
) -> UInt8[np.ndarray, "height width 3"]:
    """The panels in a row, each under its title."""
    columns = []
    for title, panel in zip(titles, panels, strict=True):
        head = np.zeros((TITLE_HEIGHT, panel.shape[1], 3), np.uint8)
        cv2.putText(head, title, (6, TITLE_HEIGHT - 8), cv2.FONT_HERSHEY_SIMPLEX, 0.55, (255, 255, 255), 1, cv2.LINE_AA)
        columns += [np.vstack([head, panel]), np.zeros((TITLE_HEIGHT + HEIGHT, GAP, 3), np.uint8)]
    return np.hstack(columns[:-1])


if __name__ == "__main__":
    tyro.cli(run)
