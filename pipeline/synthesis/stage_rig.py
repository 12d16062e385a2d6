"""Synthetic light stage: its cameras, their colour responses, lights and light patterns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from jaxtyping import Float64

from pipeline.base.seeds import generator_for
from pipeline.config.synthesize_capture import SynthesizeCapture
from pipeline.geometry.cameras import Camera

ELEVATIONS_DEG = (6.0, 28.0, -8.0, 18.0)
"""Heights of successive cameras: neighbours differ, so that views are not coplanar."""

LOWEST_LIGHT = -0.75
"""Sine of the lowest light's elevation: a stage has a floor."""

AIM_ERROR = 0.015
"""Cameras miss the stage's centre by up to this share of the framed height along each axis."""

GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))

INTENSITY_SPREAD = 0.25
"""Relative variation between lights of one partially lit frame.

Intensities must be read, not assumed equal.
"""


@dataclass(frozen=True)
class StageRig:
    """The truth about one stage.

    Attributes:
        cameras: at sensor resolution.
        raw_from_true: 3x3 colour response of each camera; their mean is the identity.
        light_positions: metres, by light name.
    """

    cameras: dict[str, Camera]
    raw_from_true: dict[str, Float64[np.ndarray, "3 3"]]
    light_positions: dict[str, Float64[np.ndarray, "3"]]

    @property
    def lights_xyz(self) -> Float64[np.ndarray, "n 3"]:
        """Light positions in the order of their names."""
        return np.stack(list(self.light_positions.values()))


def build_stage_rig(subject: str, settings: SynthesizeCapture) -> StageRig:
    """Cameras on a ring of varying height, lights on a golden-angle spiral."""
    names = [f"cam{index:02d}" for index in range(settings.cameras)]
    cameras = {name: _camera(subject, index, settings) for index, name in enumerate(names)}
    random = generator_for(subject, "color response")
    responses = np.eye(3) + settings.color_spread * random.standard_normal((settings.cameras, 3, 3))
    # A chart calibrates cameras to their average: with the identity as average, corrected colours are true ones.
    responses += np.eye(3) - responses.mean(axis=0)
    return StageRig(
        cameras=cameras,
        raw_from_true=dict(zip(names, responses, strict=True)),
        light_positions={f"L{index:03d}": p for index, p in enumerate(_dome(subject, settings))},
    )


def _dome(subject: str, settings: SynthesizeCapture) -> np.ndarray:
    """Light positions [n, 3], in an order that has nothing to do with where they are."""
    index = np.arange(settings.lights) + 0.5
    height = 1 - (1 - LOWEST_LIGHT) * index / settings.lights
    around = np.sqrt(1 - height**2)
    directions = np.stack(
        [around * np.cos(index * GOLDEN_ANGLE), height, around * np.sin(index * GOLDEN_ANGLE)], axis=1
    )
    random = generator_for(subject, "dome")
    distances = settings.light_distance_m * (1 + 0.03 * random.uniform(-1, 1, settings.lights))
    return (distances[:, None] * directions)[random.permutation(settings.lights)]


def _camera(subject: str, index: int, settings: SynthesizeCapture) -> Camera:
    random = generator_for(subject, "camera", index)
    azimuth = 2 * np.pi * (index + 0.25 * random.uniform(-1, 1)) / settings.cameras
    elevation = np.radians(ELEVATIONS_DEG[index % len(ELEVATIONS_DEG)] + 3 * random.uniform(-1, 1))
    outward = np.array([np.cos(elevation) * np.sin(azimuth), np.sin(elevation), np.cos(elevation) * np.cos(azimuth)])
    center = settings.camera_distance_m * (1 + 0.02 * random.uniform(-1, 1)) * outward
    target = AIM_ERROR * settings.framed_height_m * random.uniform(-1, 1, 3)
    R = look_at(center, target, roll=np.radians(2) * random.uniform(-1, 1))
    width = settings.width * settings.downsample_from_sensor
    height = settings.height * settings.downsample_from_sensor
    focal = height * settings.camera_distance_m / settings.framed_height_m * (1 + 0.02 * random.uniform(-1, 1))
    aspect = 1 + 0.005 * random.uniform(-1, 1)
    middle = np.array([width, height]) * (0.5 + 0.01 * random.uniform(-1, 1, 2))
    K = np.array([[focal, 0, middle[0]], [0, focal * aspect, middle[1]], [0, 0, 1]])
    spread = np.array([0.06, 0.02, 0.001, 0.001, 0.004])
    dist = settings.distortion * (np.array([-0.06, 0.02, 0, 0, 0]) + spread * random.uniform(-1, 1, 5))
    return Camera(R=R, t=-R @ center, K=K, dist=dist, width=width, height=height)


def look_at(center: np.ndarray, target: np.ndarray, roll: float = 0.0) -> Float64[np.ndarray, "3 3"]:
    """Camera-from-world rotation of an OpenCV camera at `center` that looks at `target`.

    Up in the image is +y.
    """
    forward = (target - center) / np.linalg.norm(target - center)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    upright = np.stack([right, down, forward])
    c, s = np.cos(roll), np.sin(roll)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ upright


def survey_lights(subject: str, rig: StageRig, error_m: float) -> pd.DataFrame:
    """Surveyed positions: light, x, y, z; the truth plus an error of `error_m` per coordinate."""
    error = error_m * generator_for(subject, "survey").standard_normal(rig.lights_xyz.shape)
    table = pd.DataFrame(rig.lights_xyz + error, columns=["x", "y", "z"])
    table.insert(0, "light", list(rig.light_positions))
    return table


def segment_for(frame: int, settings: SynthesizeCapture) -> tuple[str, float]:
    """Segment of a frame, and the time since the segment began, seconds."""
    first_b = settings.frames - settings.frames_b
    return ("a", frame / settings.fps) if frame < first_b else ("b", (frame - first_b) / settings.fps)


def light_patterns(subject: str, rig: StageRig, settings: SynthesizeCapture) -> pd.DataFrame:
    """One row per lit light: frame, light, intensity.

    Partially lit frames are as bright as fully lit ones on average, but brighter with more lights on: a stage's
    synchronisation can only be checked where brightness changes.
    """
    names = np.array(list(rig.light_positions))
    usual_count = (settings.partial_lights_min + settings.partial_lights_max) / 2
    rows = []
    for frame in range(settings.frames):
        random = generator_for(subject, "pattern", frame)
        if frame % settings.fully_lit_every == 0:
            lit, intensity = names, np.full(len(names), settings.total_intensity / len(names))
        else:
            count = random.integers(settings.partial_lights_min, settings.partial_lights_max, endpoint=True)
            lit = np.sort(random.choice(names, count, replace=False))
            relative = 1 + INTENSITY_SPREAD * random.uniform(-1, 1, count)
            intensity = settings.total_intensity / usual_count * relative
        rows.append(pd.DataFrame({"frame": frame, "light": lit, "intensity": np.round(intensity, 4)}))
    return pd.concat(rows, ignore_index=True)
