"""A figure in a light stage, its LEDs traced by shadow rays, and faults planted in its log.

The brightness of the figure in a camera is summed over a mesh of capsules with Embree, face by face: other geometry
and other code than the ellipsoid that the checks under test put in the figure's place.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd
import trimesh

from pipeline.sync.brightness import BrightnessModel, PatternLog, directions_from
from pipeline.sync.subject_proxy import Ellipsoid, shading_response

NOISE = 0.01
"""Of a camera's mean brightness: exposure and LEDs repeat to a percent."""


@dataclass(frozen=True)
class Stage:
    """Lights and cameras around the origin, and transport [frames, cameras, lights].

    Transport is brightness per unit intensity.
    """

    lights: np.ndarray
    cameras: np.ndarray
    transport: np.ndarray
    gains: np.ndarray
    albedo: np.ndarray

    @property
    def names(self) -> list[str]:
        return [f"L{index:03d}" for index in range(len(self.lights))]

    @property
    def frames(self) -> int:
        return len(self.transport)


def figure(turn: float, swing: float) -> trimesh.Trimesh:
    """A trunk, a head, two arms and two legs, 1.7 m tall; arms and legs swing by an angle."""

    def limb(length: float, radius: float, top: list[float], angle: float) -> trimesh.Trimesh:
        part = trimesh.creation.capsule(height=length, radius=radius, count=[8, 8])
        part.apply_translation([0, 0, -length])
        part.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2 + angle, [1, 0, 0]))
        part.apply_translation(top)
        return part

    parts = [limb(0.5, 0.16, [0, 0.45, 0], 0.0), limb(0.05, 0.11, [0, 0.75, 0], 0.0)]
    parts += [limb(0.5, 0.05, [side * 0.24, 0.45, 0], side * swing) for side in (-1, 1)]
    parts += [limb(0.75, 0.08, [side * 0.1, -0.05, 0], -side * swing) for side in (-1, 1)]
    mesh = trimesh.util.concatenate(parts)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(turn, [0, 1, 0]))
    return mesh


def dome(count: int, radius: float, lowest: float, rng: np.random.Generator) -> np.ndarray:
    index = np.arange(count) + 0.5
    height = 1 - (1 - lowest) * index / count
    around, azimuth = np.sqrt(1 - height**2), np.pi * (3 - np.sqrt(5)) * index
    directions = np.stack([around * np.cos(azimuth), height, around * np.sin(azimuth)], 1)
    return radius * directions[rng.permutation(count)]


def traced_transport(mesh: trimesh.Trimesh, lights: np.ndarray, cameras: np.ndarray) -> np.ndarray:
    """Mean of cos / d^2 times visibility over the mesh that cameras see, [cameras, lights]."""
    points = mesh.triangles_center + 1e-4 * mesh.face_normals

    def facing(targets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        offset = targets[:, None] - points
        distance = np.linalg.norm(offset, axis=2)
        cosine = np.maximum((offset * mesh.face_normals).sum(2) / distance, 0)
        lit = np.nonzero(cosine > 0)
        hidden = mesh.ray.intersects_any(points[lit[1]], (offset / distance[..., None])[lit])
        cosine[lit] *= ~hidden
        return cosine, distance

    seen, far = facing(cameras)
    seen = seen * mesh.area_faces / far**2
    cosine, distance = facing(lights)
    return seen @ (cosine / distance**2).T / seen.sum(1, keepdims=True)


def build_stage(seed: int, frames: int = 36, cameras: int = 8, lights: int = 24) -> Stage:
    """A figure that walks on the spot and turns slowly."""
    rng = np.random.default_rng(seed)
    azimuth = 2 * np.pi * np.arange(cameras) / cameras
    height = np.where(np.arange(cameras) % 2, 0.3, 1.2)
    places = np.stack([2.5 * np.sin(azimuth), height, 2.5 * np.cos(azimuth)], 1)
    leds = dome(lights, 2.2, -0.6, rng)
    turns = rng.uniform(0, 6) + 0.02 * np.arange(frames)
    steps = 0.5 * np.sin(0.4 * np.arange(frames))
    transport = np.stack([traced_transport(figure(t, s), leds, places) for t, s in zip(turns, steps, strict=True)])
    albedo = np.array([0.6, 0.4, 0.3])
    return Stage(leds, places, transport, rng.uniform(0.7, 1.4, cameras), albedo)


def photograph(stage: Stage, shown: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Brightness [frames, cameras, 3] under patterns [frames, lights, 3], a tenth of it bounced."""
    direct = np.einsum("fcl,flk->fck", stage.transport, shown)
    bounced = np.einsum("fl,flk->fk", stage.transport.mean(1), shown)[:, None]
    light = (0.9 * direct + 0.1 * bounced) * stage.albedo * stage.gains[:, None]
    return light * (1 + NOISE * rng.normal(size=(*light.shape[:2], 1))) + 1e-4 * rng.normal(size=light.shape)


def brightness_model(
    stage: Stage, log: np.ndarray, seen: np.ndarray, numbers: np.ndarray | None = None
) -> BrightnessModel:
    """Model that the checks are given: log, brightness, an ellipsoid of the figure's size."""
    numbers = np.arange(len(log)) if numbers is None else numbers
    subject = Ellipsoid(np.array([0.0, -0.05, 0.0]), np.diag([0.3, 0.85, 0.25]))
    response = shading_response(subject, stage.lights, stage.cameras)
    around = [directions_from(subject.center, positions) for positions in (stage.cameras, stage.lights)]
    return BrightnessModel(PatternLog(numbers, stage.names, log), np.arange(len(seen)), seen, response, *around)


def white(levels: np.ndarray) -> np.ndarray:
    return np.repeat(levels[..., None], 3, axis=-1)


def random_groups(stage: Stage, rng: np.random.Generator, every: int = 3) -> np.ndarray:
    """Every n-th frame fully lit, the others a few random lights of about the same power in all."""
    frames, lights = stage.frames, len(stage.lights)
    levels = np.zeros((frames, lights))
    for frame in range(frames):
        lit = np.arange(lights) if frame % every == 0 else rng.choice(lights, rng.integers(4, 9), replace=False)
        levels[frame, lit] = 38 / lights if frame % every == 0 else 38 / 6 * rng.uniform(0.75, 1.25, len(lit))
    return white(levels)


def one_at_a_time(stage: Stage, rng: np.random.Generator) -> np.ndarray:
    order = np.concatenate([rng.permutation(len(stage.lights)) for _ in range(1 + stage.frames // len(stage.lights))])
    levels = np.zeros((stage.frames, len(stage.lights)))
    levels[np.arange(stage.frames), order[: stage.frames]] = 20.0
    return white(levels)


def with_dark_frames(stage: Stage, rng: np.random.Generator) -> np.ndarray:
    levels = random_groups(stage, rng, every=4)
    levels[rng.permutation(stage.frames)[: stage.frames // 6]] = 0
    return levels


def environments(stage: Stage, rng: np.random.Generator) -> np.ndarray:
    """All LEDs on, each with its own colour: a random smooth panorama per frame."""
    directions = stage.lights / np.linalg.norm(stage.lights, axis=1, keepdims=True)
    lobes = rng.normal(size=(stage.frames, 3, 3))
    lobes /= np.linalg.norm(lobes, axis=2, keepdims=True)
    facing = np.exp(3 * (np.einsum("fjx,lx->fjl", lobes, directions) - 1))
    return np.einsum("fjl,fjk->flk", facing, rng.uniform(0, 5, (stage.frames, 3, 3))) + 0.05


def slow_turn(stage: Stage, rng: np.random.Generator) -> np.ndarray:
    """All LEDs on, brighter on a side that moves around once."""
    angle = np.arctan2(stage.lights[:, 0], stage.lights[:, 2])
    phase = 2 * np.pi * np.arange(stage.frames)[:, None] / stage.frames + rng.uniform(0, 6)
    return white(1.5 * (1 + 0.8 * np.cos(angle - phase)))


def always_fully_lit(stage: Stage, rng: np.random.Generator) -> np.ndarray:
    return white(np.full((stage.frames, len(stage.lights)), 1.6))


INTERLEAVINGS: dict[str, Callable[[Stage, np.random.Generator], np.ndarray]] = {
    "random groups": random_groups,
    "one at a time": one_at_a_time,
    "dark frames": with_dark_frames,
    "environments": environments,
    "slow turn": slow_turn,
    "always fully lit": always_fully_lit,
}


def pattern_table(log: np.ndarray, names: list[str], first: int = 0) -> pd.DataFrame:
    """frame, light, intensity_r, intensity_g, intensity_b of the lit lights."""
    frame, light = np.nonzero(log.any(2))
    table = pd.DataFrame({"frame": frame + first, "light": np.array(names)[light]})
    return table.assign(**{f"intensity_{c}": log[frame, light, i] for i, c in enumerate("rgb")})
