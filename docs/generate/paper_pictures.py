"""Draw the pictures of docs/papers_rows.md: intrinsic layers, Gaussians beside volumes, corneas under a panorama.

    python -m docs.generate.paper_pictures --results results/subjectB \\
        --gaussians rows/no_eyes --volumes rows/volumes_rgca

The two avatars are what `benchmarks.bench_rows --avatars` kept. Layers are of the image of median PSNR, as
evaluate_avatar drew them. Gaussians and volumes are shown in two validation images of different cameras, those in which
most of the eyes is seen. Writes SUBJECT_layers.jpg, SUBJECT_volumes.jpg and SUBJECT_corneas.jpg.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import tyro
from jaxtyping import UInt8

from docs.generate.pictures import JPEG_QUALITY, composed, enlarged, relit, sky
from pipeline.avatar.training.checkpoint import load_avatar
from pipeline.base.code_digest import ROOT
from pipeline.base.files import read_table
from pipeline.capture.records import ImageRecord
from pipeline.capture.shards import read_frame_shards, read_image_shards
from pipeline.metrics.comparison import preview_srgb

LAYERS_WIDTH = 1200
"""Width of the picture of layers, pixels."""

EYES_FINER = 12
"""Pixels of the picture of corneas per captured pixel, along a side."""

EYE_MARGIN = 0.2
"""What is shown around the corners of the eyes, over the distance of the outer ones."""


def run(
    *, results: Path, gaussians: Path, volumes: Path, panorama: Path | None = None, camera: str = "cam00",
    frame: int = 0, out: Path = ROOT / "docs/pictures",
) -> None:  # fmt: skip
    """Write the three pictures.

    Args:
        results: folder results/SUBJECT of a finished run of a head with eyes.
        gaussians, volumes: folders of the avatars that are held side by side.
        panorama: light of the corneas; an evening sky if none is given.
        camera, frame: that the corneas are looked at from, and when.
        out: folder of the pictures.
    """
    layers = cv2.imread(str(results / "images/full_layers.png"))[..., ::-1]
    height = round(LAYERS_WIDTH * layers.shape[0] / layers.shape[1])
    write(out / f"{results.name}_layers.jpg", cv2.resize(layers, (LAYERS_WIDTH, height), interpolation=cv2.INTER_AREA))
    write(out / f"{results.name}_volumes.jpg", beside(results, gaussians, volumes))
    with tempfile.TemporaryDirectory() as name:
        light = panorama or sky(Path(name))
        write(out / f"{results.name}_corneas.jpg", corneas(results, light, camera, frame, Path(name)))


def beside(results: Path, gaussians: Path, volumes: Path) -> UInt8[np.ndarray, "h w 3"]:
    """Captured, Gaussians and volumes, of two validation images."""
    images = read_image_shards([results / "shards/validation"])
    frames = read_frame_shards([results / "shards/frames"])
    avatars = [load_avatar(path, results / "atlas.safetensors") for path in (gaussians, volumes)]
    points = read_table(results / "index/eye_points.parquet").groupby(["camera", "frame"]).confidence.sum()
    seen = {place: points.get((image.camera, image.frame), 0.0) for place, image in enumerate(images)}
    best: dict[str, ImageRecord] = {}
    for place in sorted(seen, key=lambda place: -seen[place]):
        best.setdefault(images[place].camera, images[place])
    panels, titles = [], []
    for image in list(best.values())[:2]:
        mask = image.mask[..., None]
        drawn = [np.asarray(avatar.render(frames[image.frame], image)[0]) for avatar in avatars]
        panels += [shown(image.image * mask), *(shown(each * mask) for each in drawn)]
        titles += ["captured", "Gaussians", "volumes"]
    return composed(panels, titles)


def shown(linear: np.ndarray) -> UInt8[np.ndarray, "h w 3"]:
    """A picture of linear radiance, at the height of a panel."""
    return enlarged((255 * preview_srgb(linear) + 0.5).astype(np.uint8))


def corneas(results: Path, light: Path, camera: str, frame: int, out: Path) -> UInt8[np.ndarray, "h w 3"]:
    """The eyes of the avatar `full` under a panorama, and the panorama."""
    points = read_table(results / "index/eye_points.parquet")
    own = points[(points.camera == camera) & (points.frame == frame) & (points.confidence > 0.5)]
    images = read_image_shards([results / "shards" / split for split in ("train", "validation", "test")])
    crop = next(image for image in images if (image.camera, image.frame) == (camera, frame))
    margin = EYE_MARGIN * float(np.ptp(own.x))
    left, right = own.x.min() - margin, own.x.max() + margin
    top, bottom = own.y.min() - margin, own.y.max() + margin
    eyes = replace(crop, x0=int(left), y0=int(top), width=int(right - left), height=int(bottom - top))
    picture = relit(results, "full", light, eyes, out / "relit", EYES_FINER)
    return composed([picture, panel_of(light)], ["corneas", "their light"])


def panel_of(light: Path) -> UInt8[np.ndarray, "h w 3"]:
    """A panorama as a panel, brightest parts clipped."""
    radiance = cv2.imread(str(light), cv2.IMREAD_UNCHANGED)[..., ::-1]
    return shown(0.25 * radiance / float(np.median(radiance.mean(-1)) + 1e-9))


def write(path: Path, picture: UInt8[np.ndarray, "h w 3"]) -> None:
    """Write a picture, and say how large it is."""
    cv2.imwrite(str(path), picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    tyro.cli(run)
