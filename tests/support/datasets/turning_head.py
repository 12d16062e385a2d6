"""A head that turns in a light stage, with everything known: geometry, cameras, lights, and painted images.

Metres, y up, OpenCV's cameras, radiance in linear RGB. Faces are painted flat, far ones first, by their Lambertian
light: `albedo / pi * sum I cos / d^2`, without cast shadows.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

HEAD_RADII_M = np.array([0.075, 0.115, 0.095])
CENTER_M = np.array([0.04, 0.12, -0.03])
"""Not the origin: no stage's has to be."""

SUBPIXEL_BITS = 8

FINER = 4
"""Painted pixels along a side of an image's: OpenCV also fills the pixels that an outline touches."""


@dataclass(frozen=True)
class TrueCamera:
    """A camera at sensor resolution; K counts pixels as OpenCV does, from the centre of the first."""

    R: np.ndarray
    t: np.ndarray
    K: np.ndarray
    dist: np.ndarray
    width: int
    height: int

    def project(self, points: np.ndarray) -> np.ndarray:
        """Pixels, from the centre of the first pixel, of world points."""
        turn, _ = cv2.Rodrigues(self.R)
        points = np.asarray(points, np.float64).reshape(-1, 1, 3)
        return cv2.projectPoints(points, turn, self.t, self.K, self.dist)[0].reshape(-1, 2)


@dataclass(frozen=True)
class TurningHead:
    """Truth of a capture.

    Attributes:
        cameras: by name, at sensor resolution.
        downsample: sensor pixels along a side of an image's pixel.
        lights_m: place of each light.
        frames: frame -> radiant intensity of each lit light, one number or three of R, G and B.
        keyed: frames at which the motion bends; in between it is linear, and turns evenly.
        still: True if nothing moves.
    """

    cameras: dict[str, TrueCamera]
    downsample: int
    lights_m: np.ndarray
    frames: dict[int, dict[int, float | np.ndarray]]
    keyed: tuple[int, ...]
    still: bool = False

    @cached_property
    def _shape(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        sphere = trimesh.creation.icosphere(subdivisions=2)
        unit = np.array(sphere.vertices)
        nose = np.exp(-(((unit - [0.0, -0.1, 1.0]) / [0.25, 0.35, 0.5]) ** 2).sum(1))
        chin = np.exp(-(((unit - [0.0, -0.8, 0.6]) / 0.5) ** 2).sum(1))
        plain = HEAD_RADII_M * unit + 0.025 * nose[:, None] * [0.0, 0.0, 1.0]
        return plain, chin[:, None] * np.array([0.0, -0.02, 0.005]), np.array(sphere.faces)

    @property
    def faces(self) -> np.ndarray:
        """Triangles, counterclockwise seen from outside."""
        return self._shape[2]

    def opening(self, frame: int) -> float:
        """How far the mouth is open, 0..1: up and down from keyed frame to keyed frame."""
        return 0.0 if self.still else float(np.interp(frame, self.keyed, [k % 2 for k in range(len(self.keyed))]))

    def in_head(self, frame: int) -> np.ndarray:
        """Vertices in the frame of the head."""
        plain, bulge, _ = self._shape
        return plain + self.opening(frame) * bulge

    @cached_property
    def mean_in_head(self) -> np.ndarray:
        """Mean vertices of the keyed frames, in the frame of the head."""
        return np.mean([self.in_head(frame) for frame in self.keyed], axis=0)

    def pose(self, frame: int) -> tuple[np.ndarray, np.ndarray]:
        """World from head: R and t. The head turns about an oblique axis while its middle moves along a line."""
        frame = self.keyed[0] if self.still else frame
        angle = 0.05 * (frame - self.keyed[0]) - 0.2
        R = Rotation.from_rotvec(angle * np.array([0.2, 0.95, 0.1])).as_matrix()
        middle = CENTER_M + 0.002 * (frame - self.keyed[0]) * np.array([1.0, 0.3, -0.5])
        return R, middle - R @ self.mean_in_head.mean(0)

    def vertices(self, frame: int) -> np.ndarray:
        """Vertices in the world."""
        R, t = self.pose(frame)
        return self.in_head(frame) @ R.T + t

    @cached_property
    def albedo(self) -> np.ndarray:
        """Colour of each face: skin with a darker top and coloured patches."""
        middle = self._shape[0][self.faces].mean(1) / HEAD_RADII_M
        skin = np.tile([0.72, 0.5, 0.4], (len(middle), 1))
        skin[self.hair] = [0.25, 0.18, 0.14]
        return skin * (0.85 + 0.15 * np.sign(np.sin(9 * middle[:, :1]) * np.sin(7 * middle[:, 1:2])))

    @cached_property
    def hair(self) -> np.ndarray:
        """Faces that count as hair."""
        return self._shape[0][self.faces].mean(1)[:, 1] > 0.5 * HEAD_RADII_M[1]

    def image_size(self, name: str) -> tuple[int, int]:
        """Width and height of a camera's images."""
        camera = self.cameras[name]
        return camera.width // self.downsample, camera.height // self.downsample

    def image(self, name: str, frame: int) -> np.ndarray:
        """Linear RGB of the image, black beside the head."""
        return self.lit_by(name, frame, self.frames[frame])

    def lit_by(self, name: str, frame: int, lights: dict[int, float | np.ndarray]) -> np.ndarray:
        """Linear RGB of the image under other lights."""
        vertices = self.vertices(frame)
        corners = vertices[self.faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        radiance = np.zeros((len(self.faces), 3))
        for light, intensity in lights.items():
            away = self.lights_m[light] - corners.mean(1)
            distance = np.linalg.norm(away, axis=1, keepdims=True)
            cosine = np.clip((normal * away).sum(1, keepdims=True) / distance, 0, None)
            radiance += self.albedo / np.pi * intensity * cosine / distance**2
        fine = self._painted(name, vertices, radiance, self.downsample)
        height, width = fine.shape[0] // FINER, fine.shape[1] // FINER
        return fine.reshape(height, FINER, width, FINER, 3).mean((1, 3)).astype(np.float32)

    def labels(self, name: str, frame: int, values: np.ndarray, coarser: int = 1) -> np.ndarray:
        """Image in which each face has its value; `coarser` pixels along a side become one."""
        fine = self._painted(name, self.vertices(frame), values[:, None].astype(np.float64), self.downsample * coarser)
        middle = FINER // 2
        return fine[middle::FINER, middle::FINER, 0].astype(np.uint8)

    def _painted(self, name: str, vertices: np.ndarray, values: np.ndarray, coarser: int) -> np.ndarray:
        """Pixels `FINER` times smaller than those of an image `coarser` than the sensor."""
        camera, factor = self.cameras[name], coarser / FINER
        # From pixel centres of the sensor to those of the image: (c + 0.5) / d - 0.5.
        pixels = (camera.project(vertices) + 0.5) / factor - 0.5
        toward = vertices @ camera.R.T + camera.t
        corners = pixels[self.faces]
        side, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        # Counterclockwise in the world is clockwise on an image whose y points down.
        front = side[:, 0] * other[:, 1] - side[:, 1] * other[:, 0] < 0
        order = np.argsort(-toward[self.faces].mean(1)[:, 2])
        shape = (camera.height // coarser * FINER, camera.width // coarser * FINER, values.shape[1])
        outlines = np.round(corners * 2**SUBPIXEL_BITS).astype(np.int32)
        painted = np.zeros(shape)
        for face in order[front[order]]:
            cv2.fillConvexPoly(painted, outlines[face], values[face].tolist(), shift=SUBPIXEL_BITS)
        return painted


def looking_at(place: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """R and t of a camera at `place` that looks at `target`, y up."""
    forward = (target - place) / np.linalg.norm(target - place)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(forward, right), forward])
    return R, -R @ place


def ring_of_cameras(
    names: list[str], size: tuple[int, int], distance_m: float = 1.0, arc: float = 140.0
) -> dict[str, TrueCamera]:
    """Cameras on an arc in front of the head, with lenses that differ.

    Args:
        size: width and height of the sensor, pixels.
        arc: from the first to the last, degrees.
    """
    width, height = size
    cameras = {}
    for number, name in enumerate(names):
        around = np.radians(arc * (number / max(len(names) - 1, 1) - 0.5))
        up = 0.25 * (-1) ** number
        place = CENTER_M + distance_m * np.array([np.sin(around), up, np.cos(around)])
        R, t = looking_at(place, CENTER_M)
        f = 2.1 * height * (1 + 0.02 * number)
        K = np.array([[f, 0, 0.51 * width + 0.3 * number], [0, 1.003 * f, 0.49 * height - 0.2 * number], [0, 0, 1]])
        dist = np.array([-0.09 + 0.01 * number, 0.03, 0.0012, -0.0015, 0.0])
        cameras[name] = TrueCamera(R, t, K, dist, width, height)
    return cameras


def dome_of_lights(count: int, radius_m: float = 1.2) -> np.ndarray:
    """Lights spread evenly over a sphere round the head, by the golden angle."""
    z = 1 - 2 * (np.arange(count) + 0.5) / count
    around = np.pi * (3 - np.sqrt(5)) * np.arange(count)
    ring = np.sqrt(1 - z**2)
    return CENTER_M + radius_m * np.stack([ring * np.cos(around), z, ring * np.sin(around)], 1)


SKY, LAMP = np.array([0.06, 0.08, 0.12]), np.array([0.9, 0.6, 0.3])
SHARPNESS = 4
"""Power of the cosine to the lamp's direction."""


def environment(lights_m: np.ndarray, toward: tuple[float, float, float]) -> dict[int, np.ndarray]:
    """Brightness of each light in three channels, over that alone: a sky, and a warm lamp in a direction."""
    away = lights_m - CENTER_M
    cosine = away @ np.array(toward) / np.linalg.norm(away, axis=1) / np.linalg.norm(toward)
    return {light: SKY + max(float(c), 0.0) ** SHARPNESS * LAMP for light, c in enumerate(cosine)}
