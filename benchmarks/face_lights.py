"""A real head under seven LEDs close by: light on its skin by the pipeline's near and distant lights.

Photographs and calibration: yqueau/near_ps, `Datasets/Human1`. One camera at the origin, x right, y down, z forward;
the stored values less those without LEDs are the most linear.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import torch
from jaxtyping import Float32, Float64
from scipy.io import loadmat

from pipeline.effects.appearance_evidence import Evidence
from pipeline.effects.scene_evidence import near_field_evidence
from pipeline.lighting.distant import gather_harmonics, light_harmonics
from pipeline.lighting.point_lights import PointLights
from tests.support.avatars.sheet import make_sheet

IMAGES = (1, 2, 3, 4, 6, 7, 8)
"""Numbers of the photographs, and of their LEDs from 1: the fifth was not published."""

REDUCED = (650, 433)
"""Width and height the photographs are averaged down to: a pixel is 0.7 mm of the head."""

HEAD_M = 0.7
"""Distance of the plane that stands for the head."""

DEGREE_ONE = slice(1, 4)
"""Of the coefficients of light: m = -1, 0, 1 are y, z and x of the light's vector, times a constant."""

Model = Literal["near", "distant"]


@dataclass(frozen=True)
class LitFace:
    """The head as photographed.

    Attributes:
        colors: of each pixel on the head under each LED, less ambient light, in counts, RGB.
        points: of the plane that stands for the head at the pixels, metres.
        positions: of the LEDs, metres.
        intensities: of the LEDs along their axes, RGB, in counts times square metres.
        axes: unit directions the LEDs face.
    """

    colors: Float64[np.ndarray, "lights pixels 3"]
    points: Float64[np.ndarray, "pixels 3"]
    positions: Float64[np.ndarray, "lights 3"]
    intensities: Float64[np.ndarray, "lights 3"]
    axes: Float64[np.ndarray, "lights 3"]

    def offsets(self) -> tuple[Float64[np.ndarray, "lights pixels"], Float64[np.ndarray, "lights pixels"]]:
        """Distance of each point from each LED, and the cosine it is seen at from the LED's axis."""
        away = self.points - self.positions[:, None]
        distance = np.linalg.norm(away, axis=2)
        return distance, (away * self.axes[:, None]).sum(2) / distance


def read_lit_face(folder: Path, step: int = 1) -> LitFace:
    """Read the photographs, of which every `step`-th pixel of the head is kept."""
    mask = cv2.imread(str(folder / "mask_2601x1732.png"), cv2.IMREAD_UNCHANGED)
    inside = cv2.resize(mask, REDUCED, interpolation=cv2.INTER_AREA) == 255
    row, column = (index[::step] for index in np.nonzero(inside))
    ambient = read_colors(folder / "ambient.png")[row, column]
    colors = [read_colors(folder / f"{number:04d}.png")[row, column] - ambient for number in IMAGES]
    K, lights = loadmat(folder / "camera.mat")["K"].astype(np.float64), loadmat(folder / "light.mat")
    size = np.array(mask.shape[::-1]) / REDUCED
    in_plane = ((np.stack([column, row], 1) + 0.5) * size - K[:2, 2]) / np.diag(K)[:2]
    points = HEAD_M * np.concatenate([in_plane, np.ones((len(in_plane), 1))], 1)
    some = np.array(IMAGES) - 1
    return LitFace(
        np.stack(colors).astype(np.float64), points, lights["S"][some] / 1e3,
        lights["Phi"][some].astype(np.float64) / 1e6, lights["Dir"][some].astype(np.float64),
    )  # fmt: skip


def read_colors(path: Path) -> Float32[np.ndarray, "height width 3"]:
    stored = cv2.imread(str(path), cv2.IMREAD_COLOR)
    return cv2.resize(stored, REDUCED, interpolation=cv2.INTER_AREA).astype(np.float32)[..., ::-1]


def unexplained(face: LitFace, model: Model, falloff: float = 2.0, lobe: float = 1.0) -> Float64[np.ndarray, "3"]:
    """Share of the photographs' energy that a matte head does not explain, of each channel.

    Each pixel has a normal and an albedo of its own, and no shadow: three numbers, by linear least squares, against one
    per photograph.

    Args:
        model: `near` asks for the light at each point, `distant` for that at the middle of the head.
        falloff: exponent of distance; 0: an LED is as bright at the head as its intensity says, however far it is.
        lobe: an LED sends cos(angle to its axis) ** lobe; 0: alike to all sides.
    """
    distance, cosine = face.offsets()
    changed = cosine.clip(0) ** lobe * distance ** (2 - falloff)
    middle = int(np.argmin(np.linalg.norm(face.points - face.points.mean(0), axis=1)))
    vectors = np.stack([_light_vectors(face, number, model) for number in range(len(face.positions))])
    vectors = vectors * (changed if model == "near" else changed[:, [middle]])[..., None, None]
    left = np.zeros(3)
    for c in range(3):
        columns, seen = vectors[..., c].swapaxes(0, 1), face.colors[..., c].T[..., None]
        normal = columns.swapaxes(1, 2) @ columns
        matte = np.linalg.solve(normal, columns.swapaxes(1, 2) @ seen)
        left[c] = ((seen - columns @ matte) ** 2).sum() / (seen**2).sum()
    return left


def _light_vectors(face: LitFace, number: int, model: Model) -> Float64[np.ndarray, "pixels 3 channels"]:
    """I / d^2 times the direction to one LED, times a constant, as the avatar's lighting has it."""
    positions, intensities = face.positions[number : number + 1], face.intensities[number : number + 1]
    light = PointLights(torch.tensor(positions), torch.tensor(intensities))
    points, turn = torch.tensor(face.points), torch.eye(3, dtype=torch.float64)
    if model == "near":
        return gather_harmonics(points, turn, light)[:, DEGREE_ONE].numpy()
    distant = light_harmonics(points.mean(0), turn, light)[DEGREE_ONE].numpy()
    return np.broadcast_to(distant, (len(points), *distant.shape))


def face_evidence(face: LitFace, rays: int, random: np.random.Generator) -> Evidence:
    """What plan_effects measures for `near_field`: the LEDs over the part of the plane that shows the head."""
    (left, top, z), (right, bottom, _) = face.points.min(0), face.points.max(0)
    corners = np.array([[left, top, z], [right, top, z], [right, bottom, z], [left, bottom, z]])
    return near_field_evidence(make_sheet(64), [(corners, face.positions)], rays, random)
