"""A capture of the papers' size in which tables are whole and images are links to one: enough to plan its jobs."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import yaml

from pipeline.base.files import write_json
from pipeline.config.effects import EFFECTS

PLANNED = ("near_field", "specular", "deferred", "shadow", "articulation", "lens_distortion", "color_correction")
"""Effects that are on: all that a body of matte cloth and glossy skin shows."""

FULLY_LIT_EVERY, PARTIAL_LIGHTS = 3, 5
"""Every third frame is fully lit, the others have five lights (RFGCA 4, RGCA 3)."""

REAL_FOLDERS = 2
"""Cameras with a folder of their own; those of all others are links. Two have more files than a plan looks at."""

LINKED = ("Snakefile", "workflow", "pipeline", "envs", "profiles", ".git")
"""Parts of the project that a copy shares with it."""


@dataclass(frozen=True)
class PaperSize:
    """Numbers of a capture; the defaults are those of RFGCA, whose frames are rounded."""

    cameras: int = 512
    lights: int = 1024
    frames: int = 5000
    width: int = 1332
    height: int = 1152


def write_project(root: Path, folder: Path, size: PaperSize, subject: str = "paper") -> None:
    """The project at `root` with one subject, a capture of that size."""
    folder.mkdir(parents=True)
    for name in LINKED:
        if (root / name).exists():
            (folder / name).symlink_to(root / name)
    shutil.copytree(root / "config", folder / "config", ignore=shutil.ignore_patterns("subjects"))
    (folder / "config/subjects").mkdir()
    (folder / f"config/subjects/{subject}.yaml").write_text("source: native\n")
    write_capture(folder / "captures" / subject, size, subject)


def write_capture(folder: Path, size: PaperSize, subject: str) -> None:
    """The folder of a capture: capture.yaml, tables, and images."""
    folder.mkdir(parents=True)
    cameras = [f"cam{number:03d}" for number in range(size.cameras)]
    lights = [f"L{number:04d}" for number in range(size.lights)]
    sides = {"width": size.width, "height": size.height}
    sensor = {f"sensor_{name}": 4 * side for name, side in sides.items()}
    pd.DataFrame({"camera": cameras, **sides, **sensor}).to_csv(folder / "cameras.csv", index=False)
    frames = np.arange(size.frames)
    table = pd.DataFrame({"frame": frames, "timestamp_s": frames / 24, "segment": "a"})
    table.to_csv(folder / "frames.csv", index=False)
    places = pd.DataFrame(fibonacci(size.lights), columns=list("xyz")).assign(light=lights)
    places.to_csv(folder / "lights.csv", index=False)
    patterns(frames, np.array(lights)).to_csv(folder / "patterns.csv", index=False)
    write_links(folder, cameras, frames)
    described = {
        "format": "lightstage-capture/1", "subject": subject, "kind": "body", "units": "m", "up": "+y", "fps": 24,
        "images": {
            "path": "images/{camera}/{frame:06d}.png", "transfer": "srgb", "black_level": 0,
            "downsample_from_sensor": 4,
        },
        "calibration": {
            "lights": {
                "method": "mirror_ball", "path": "ball/{position}/{camera}/{light}.png", "radius_m": 0.1,
                "silhouette": "ball/{position}/{camera}/silhouette.png",
            },
        },
        **{name: f"{name}.csv" for name in ("cameras", "frames", "lights", "patterns")},
    }  # fmt: skip
    (folder / "capture.yaml").write_text(yaml.safe_dump(described, sort_keys=False))


def fibonacci(count: int) -> np.ndarray:
    """Evenly spread places on a sphere of 2.5 m."""
    height = 1 - 2 * (np.arange(count) + 0.5) / count
    turn, across = np.pi * (1 + 5**0.5) * np.arange(count), np.sqrt(1 - height**2)
    return 2.5 * np.stack([across * np.cos(turn), height, across * np.sin(turn)], 1)


def patterns(frames: np.ndarray, lights: np.ndarray) -> pd.DataFrame:
    """Lit lights of every frame."""
    generator = np.random.default_rng(0)
    lit = [
        np.arange(len(lights))
        if frame % FULLY_LIT_EVERY == 0
        else generator.choice(len(lights), min(PARTIAL_LIGHTS, len(lights)), replace=False)
        for frame in frames
    ]
    numbers = np.repeat(frames, [len(each) for each in lit])
    return pd.DataFrame({"frame": numbers, "light": lights[np.concatenate(lit)], "intensity": 1.0})


def write_links(folder: Path, cameras: Iterable[str], frames: np.ndarray) -> None:
    """One image, and links to it: of each frame of some cameras, and of the folders of all others."""
    (folder / "images").mkdir()
    picture = np.random.default_rng(0).integers(0, 255, (8, 8, 3), np.uint8)
    cv2.imwrite(str(folder / "image.png"), picture)
    for number, camera in enumerate(cameras):
        own = folder / "images" / camera
        if number >= REAL_FOLDERS:
            own.symlink_to("cam000")
            continue
        own.mkdir()
        for frame in frames.tolist():
            os.symlink("../../image.png", own / f"{frame:06d}.png")


def write_finished(folder: Path, files: Iterable[str], subject: str) -> None:
    """Empty files in place of what stages wrote, and what a plan reads of them: the kind and the planned effects."""
    for name in files:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    results = folder / "results" / subject
    write_json(results / "index/capture.json", {"kind": "body"})
    write_json(results / "effects.json", {name: {"on": name in PLANNED} for name in EFFECTS})
