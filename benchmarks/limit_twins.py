"""Jobs of `benchmarks.bench_limits` that a library does the hard part of, beside that part alone."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from benchmarks.irradiance_poses import dome, make_pose, ready_rays, trace_map
from pipeline.capture.crops import cut_crop
from pipeline.capture.images import read_image
from pipeline.capture.index.image_checks import ExpectedImage, inspect_image
from pipeline.geometry.cameras import Camera


@dataclass(frozen=True)
class Twin:
    """A job, and the part of it that nothing here can make faster.

    Attributes:
        what, limit: names of both.
        size: in words.
        unit: of `count`.
        run, bare: the job, and the part.
        count: done in one run of either.
    """

    what: str
    limit: str
    size: str
    unit: str
    run: Callable[[], object]
    bare: Callable[[], object]
    count: float


def tracing() -> list[Twin]:
    """Irradiance of a dented ball against Embree's answers to the same rays, made beforehand."""
    lights, twins = dome(24), []
    for name, samples, side in (("all lamps", None, 128), ("one lamp per texel", 1, 256)):
        pose = make_pose(side)
        ready = ready_rays(pose, lights, samples)
        size = f"{side} x {side} texels, {len(lights.places)} lamps, {len(pose.faces):,} faces"
        twins.append(Twin(
            f"tracing irradiance, {name}", "Embree alone, same rays", size, "rays",
            lambda pose=pose, ready=ready, samples=samples: trace_map(pose, ready.occluders, lights, samples),
            ready.answers, ready.count,
        ))  # fmt: skip
    return twins


@contextmanager
def decoding() -> Iterator[list[Twin]]:
    """Checking and packing PNG files against OpenCV's decoding of their bytes in memory."""
    height, width, count = 640, 480, 6
    with tempfile.TemporaryDirectory() as name:
        folder, mask = Path(name), subject(height, width)
        contents = {}
        for number in range(count):
            path = folder / f"{number}.png"
            cv2.imwrite(str(path), picture(mask, number))
            contents[path] = np.frombuffer(path.read_bytes(), np.uint8)
        K = np.array([[1.2 * height, 0, width / 2], [0, 1.2 * height, height / 2], [0, 0, 1]])
        camera = Camera(np.eye(3), np.zeros(3), K, np.array([-0.1, 0.02, 1e-3, 1e-3, 0.0]), width, height)
        corrected = np.eye(3) + 0.01

        def decode() -> None:
            for content in contents.values():
                cv2.imdecode(content, cv2.IMREAD_UNCHANGED)

        def inspect() -> None:
            for path in contents:
                inspect_image(folder, ExpectedImage(path.name, "color", "c", (width, height)))

        def pack(undistort: bool) -> None:
            for path in contents:
                cut_crop(read_image(path, "srgb"), mask, camera, corrected_from_raw=corrected, undistort=undistort)

        size = f"{count} images of {width} x {height}, 8 bits, sRGB"
        limit = "cv2.imdecode alone"
        yield [
            Twin(what, limit, size, "pixels", run, decode, count * height * width)
            for what, run in {
                "checking images (index_capture)": inspect,
                "correcting and cutting images (pack_shards)": lambda: pack(undistort=False),
                "the same, undistorting them": lambda: pack(undistort=True),
            }.items()
        ]  # fmt: skip


def subject(height: int, width: int) -> np.ndarray:
    """Mask of an ellipse that takes a third of the image, 0 or 1."""
    down, across = np.mgrid[:height, :width]
    inside = ((down / height - 0.5) / 0.42) ** 2 + ((across / width - 0.5) / 0.25) ** 2 < 1
    return inside.astype(np.float32)


def picture(mask: np.ndarray, seed: int) -> np.ndarray:
    """A shaded, noisy subject before a dark, noisy background, 8 bits."""
    draws = np.random.default_rng(seed)
    shade = mask * (60 + 120 * np.linspace(1, 0, mask.shape[0])[:, None])
    noisy = shade[..., None] * [1.0, 0.8, 0.6] + draws.normal(4, 1.5, (*mask.shape, 3))
    return noisy.clip(0, 255).astype(np.uint8)
