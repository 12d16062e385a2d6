"""Images of the walking figure: matte triangles of their own colours under lights around.

Painted with OpenCV from back to front; shading by the cosine at each triangle's centre. No code of the tracker's.
"""

from __future__ import annotations

import cv2
import numpy as np
import pandas as pd

from pipeline.base.exr import write_exr
from pipeline.base.files import read_table, write_table
from pipeline.geometry.cameras import Camera
from tests.support.captures.walking import DOWNSAMPLE
from tests.support.figures.walking import Motion, ring_of_cameras

FACTOR, BITS = 4, 4
"""Finer pixels per side while painting, and fixed-point bits of OpenCV's corners."""

NOISE = 0.005
"""Of a pixel, where white reflects about 1."""


def light_positions(count: int = 20, radius: float = 2.5) -> np.ndarray:
    """Points spread evenly over a sphere around the figure's chest."""
    index = np.arange(count) + 0.5
    y, turn = 1 - 2 * index / count, index * np.pi * (3 - np.sqrt(5))
    around = np.sqrt(1 - y**2)
    return [0, 1, 0] + radius * np.stack([around * np.cos(turn), y, around * np.sin(turn)], 1)


def paint(
    camera: Camera, vertices: np.ndarray, faces: np.ndarray, albedo: np.ndarray, lights: np.ndarray, seed: int
) -> np.ndarray:
    """Paint a linear image under lights of intensity 1 with inverse-square falloff."""
    pixels, depth = camera.project(vertices)
    corners = np.round((pixels * FACTOR - 0.5) * 2**BITS).astype(np.int32)[faces]
    edges = vertices[faces[:, 1:]] - vertices[faces[:, :1]]
    normals = np.cross(edges[:, 0], edges[:, 1])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    centers = vertices[faces].mean(1)
    way = lights - centers[:, None]
    distance = np.linalg.norm(way, axis=2)
    shading = np.maximum((way * normals[:, None]).sum(2), 0) / distance**3
    colors = albedo * shading.sum(1)[:, None]
    facing = ((camera.center - centers) * normals).sum(1) > 0
    large = np.zeros((camera.height * FACTOR, camera.width * FACTOR, 3), np.float32)
    for face in np.argsort(-depth[faces].mean(1)):
        if facing[face]:
            cv2.fillConvexPoly(large, corners[face], colors[face].tolist(), shift=BITS)
    image = cv2.resize(large, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    return image + NOISE * np.random.default_rng(seed).normal(size=image.shape).astype(np.float32)


def add_images(paths: dict, motion: Motion, lit: np.ndarray, response: float = 0.1) -> dict:
    """Add images of `lit` frames, patterns and lights to a capture; returns all paths.

    Camera c has its own colour response: `response` is how far it is from the identity.
    """
    random = np.random.default_rng(3)
    albedo = random.uniform(0.1, 0.9, (len(motion.faces), 3))
    lights = light_positions()
    rows = []
    for number, (name, camera) in enumerate(ring_of_cameras(6).items()):
        matrix = np.eye(3) + response * random.uniform(-1, 1, (3, 3))
        small = camera.downsampled(DOWNSAMPLE)
        for frame in range(len(motion.times_s)):
            path = f"{name}_{frame:03d}.exr"
            rows.append((name, frame, path))
            if lit[frame]:
                image = paint(small, motion.vertices[frame], motion.faces, albedo, lights, 100 * number + frame)
                write_exr(paths["capture"] / path, image @ matrix.T.astype(np.float32))
    images = read_table(paths["index"] / "images.parquet")
    images = images.merge(pd.DataFrame(rows, columns=["camera", "frame", "path"]), on=["camera", "frame"])
    write_table(paths["index"] / "images.parquet", images)
    names = [f"L{i:02d}" for i in range(len(lights))]
    positions = pd.DataFrame(lights, columns=["x", "y", "z"]).assign(light=names)
    patterns = [(f, n, bool(lit[f])) for f in range(len(lit)) for n in (names if lit[f] else names[:3])]
    table = pd.DataFrame(patterns, columns=["frame", "light", "fully_lit"])
    table = table.assign(intensity_r=1.0, intensity_g=1.0, intensity_b=1.0)
    tables = {"patterns": table, "lights": positions}
    files = {name: paths["capture"] / f"{name}.parquet" for name in tables}
    for name, file in files.items():
        write_table(file, tables[name])
    return paths | files
