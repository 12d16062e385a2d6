"""What a run says about a capture, and whether two runs say the same as far as either is known to be right."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.files import read_arrays, read_json, read_table
from pipeline.geometry.cameras import read_cameras
from tests.support.chaos.sound_run import CAPTURE, RESULTS


@dataclass(frozen=True)
class Answers:
    """Answers of a run, in the order of cameras and lights; names may differ.

    Attributes:
        centers_m: of cameras.
        lights_m: positions of lights.
        vertices_m: [frames, vertices, 3] tracked.
        colors: the matrix of each camera.
        lit: frame by light: what was on, and how bright.
        shown: digests of images and masks, by camera and frame.
    """

    centers_m: np.ndarray
    lights_m: np.ndarray
    vertices_m: np.ndarray
    colors: np.ndarray
    lit: np.ndarray
    shown: np.ndarray


def read(folder: Path, renamed: tuple[str, str] | None = None) -> Answers:
    """Answers in a project's folder, after pack_shards; a camera or light that was renamed under its former name."""
    results = folder / RESULTS
    old, new = renamed or ("", "")
    cameras = read_cameras(results / "calibration/cameras.json")
    cameras = {name: cameras[name] for name in sorted(cameras, key=lambda name: old if name == new else name)}
    lights = read_table(results / "calibration/lights.parquet")
    lights = lights.sort_values("light", key=lambda names: names.replace(new, old) if new else names)
    color = read_json(results / "calibration/color.json")["cameras"]
    patterns = read_table(results / "patterns.parquet")
    frames = sorted(read_table(results / "frames.parquet").frame)
    lit = np.zeros((len(frames), len(lights), 3))
    places = {name: place for place, name in enumerate(lights.light)}
    for row in patterns.itertuples():
        lit[frames.index(row.frame), places[row.light]] = (row.intensity_r, row.intensity_g, row.intensity_b)
    images = read_table(results / "index/images.parquet")
    order = images.camera.map({name: place for place, name in enumerate(cameras)})
    images = images.assign(order=order).sort_values(["order", "frame"])
    tracked = read_arrays(results / "tracking/0000.safetensors")
    return Answers(
        np.array([-camera.R.T @ camera.t for camera in cameras.values()]),
        lights[["x", "y", "z"]].to_numpy(), tracked["vertices"], np.array([color[name] for name in cameras]), lit,
        images[["digest", "mask_digest"]].astype(str).to_numpy(),
    )  # fmt: skip


def _truth(sound: Path) -> Answers:
    """The truth about the sound capture, as far as it is answered."""
    folder = sound / CAPTURE / "truth"
    cameras, sound_answers = read_cameras(folder / "cameras.json"), read(sound)
    lights = pd.read_parquet(folder / "lights.parquet")
    raw = read_json(folder / "color.json")["raw_from_true"]
    return Answers(
        np.array([-camera.R.T @ camera.t for camera in cameras.values()]), lights[["x", "y", "z"]].to_numpy(),
        read_arrays(folder / "tracking.safetensors")["vertices"],
        np.array([np.linalg.inv(raw[name]) for name in cameras]), sound_answers.lit, sound_answers.shown,
    )  # fmt: skip


DISTANCES: dict[str, Callable[[np.ndarray, np.ndarray], float]] = {
    "centers_m": lambda one, two: float(np.linalg.norm(one - two, axis=-1).max()),
    "lights_m": lambda one, two: float(np.linalg.norm(one - two, axis=-1).max()),
    "vertices_m": lambda one, two: float(np.linalg.norm(one - two, axis=-1).mean()),
    "colors": lambda one, two: float(np.abs(one - two).max()),
    "lit": lambda one, two: float(np.abs(one - two).max()),
    "shown": lambda one, two: float((one != two).sum()),
}


def departures(sound: Answers, found: Answers, folder: Path) -> list[str]:
    """Answers that are further from the sound run's than that is from the truth: below, both are as good."""
    truth, said = _truth(folder), []
    for name, distance in DISTANCES.items():
        ours, theirs, true = (getattr(answers, name) for answers in (sound, found, truth))
        if ours.shape != theirs.shape:
            said.append(f"{name}: {theirs.shape} in place of {ours.shape}")
            continue
        allowed, away = distance(ours, true), distance(ours, theirs)
        if not away <= allowed:
            said.append(f"{name}: {away:.3g} from the sound run, which is {allowed:.3g} from the truth")
    return said
