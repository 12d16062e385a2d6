"""A drawn capture of mirror balls: 12 lights, 2 balls, 3 cameras.

The rig's frame is not the stage's.

Rays are traced through 4 x 4 points per pixel and blurred as a lens does; the pipeline only writes files.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import scipy.spatial.transform

from pipeline.base.files import write_json, write_table
from pipeline.geometry.cameras import Camera, write_cameras

SIZE = 300
RADIUS = 0.18
BALLS = {"0": np.array([-0.25, 0.25, -0.2]), "1": np.array([0.3, -0.25, 0.25])}
SURVEY_SIGMA = 0.02
EMITTER = 0.05
LENS_BLUR_PX = 0.7
"""Standard deviation: a sharp highlight would hide inside one pixel, and could not be placed in it."""


def cameras_in_stage():
    cameras = {}
    for name, angle in (("east", 0.0), ("north", 2.0), ("west", 4.2)):
        R = scipy.spatial.transform.Rotation.from_euler("XY", [np.pi, angle]).as_matrix()
        K = np.array([[450.0, 0, SIZE / 2], [0, 450, SIZE / 2], [0, 0, 1]])
        cameras[name] = Camera(R, np.array([0.0, 0.0, 2.2]), K, np.zeros(5), SIZE, SIZE)
    return cameras


def planted_lights():
    rng = np.random.default_rng(1)
    lights = rng.normal(size=(12, 3))
    return 2.0 * lights / np.linalg.norm(lights, axis=1, keepdims=True)


def mirror(camera, ball):
    """Trace 4 x 4 rays per pixel: (hit, points, mirrored directions), the last two of hits."""
    steps = (np.arange(4 * SIZE) + 0.5) / 4
    x, y = np.meshgrid(steps, steps)
    ray = np.stack([(x - SIZE / 2) / 450, (y - SIZE / 2) / 450, np.ones_like(x)], -1) @ camera.R
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    toward = ball - camera.center
    along = ray @ toward
    root = along**2 - toward @ toward + RADIUS**2
    hit = root > 0
    points = camera.center + (along[hit] - np.sqrt(root[hit]))[:, None] * ray[hit]
    normal = (points - ball) / RADIUS
    return hit, points, ray[hit] - 2 * (ray[hit] * normal).sum(-1, keepdims=True) * normal


def draw(mirrored, light):
    """The ball with a round light in it, or its silhouette where `light` is None."""
    hit, points, direction = mirrored
    image = np.where(hit, 0.02, 0.7 if light is None else 0.01)
    if light is not None:
        to_light = light - points
        ahead = (to_light * direction).sum(-1)
        lit = (ahead > 0) & ((to_light**2).sum(-1) - ahead**2 < EMITTER**2)
        image[hit] = np.where(lit, 0.9, 0.01)
    image = cv2.GaussianBlur(image, (0, 0), 4 * LENS_BLUR_PX)
    return image.reshape(SIZE, 4, SIZE, 4).mean((1, 3))


def write_ball_capture(folder):
    """Images, index and rig.json."""
    lights = planted_lights()
    images, silhouettes = [], []
    for name, camera in cameras_in_stage().items():
        for position, ball in BALLS.items():
            mirrored = mirror(camera, ball)
            for light in (None, *range(len(lights))):
                path = f"{name}_{position}_{light}.png"
                gray = draw(mirrored, None if light is None else lights[light])
                cv2.imwrite(str(folder / path), np.round(255 * gray).astype(np.uint8))
                entry = {"position": position, "camera": name, "path": path, "digest": ""}
                (silhouettes if light is None else images).append(
                    entry if light is None else {**entry, "light": f"L{light}"}
                )
    content = {"method": "mirror_ball", "radius_m": RADIUS, "images": images, "silhouettes": silhouettes}
    write_json(folder / "index/calibration_lights.json", content)
    write_json(folder / "index/calibration_cameras.json", {"method": "charuco"})
    survey = lights + np.random.default_rng(2).normal(0, SURVEY_SIGMA, lights.shape)
    rows = [(f"L{k}", *row) for k, row in enumerate(survey)]
    rows.append(("L99", 1.0, 2.0, 3.0))  # a light of which there are no images
    write_table(folder / "index/lights.parquet", pd.DataFrame(rows, columns=["light", "x", "y", "z"]))
    R = scipy.spatial.transform.Rotation.from_rotvec([0.3, -1.0, 0.5]).as_matrix()
    t = np.array([0.4, -2.0, 1.0])  # x_rig = R x_stage + t
    rig = {name: replace(c, R=c.R @ R.T, t=c.t - c.R @ R.T @ t) for name, c in cameras_in_stage().items()}
    write_cameras(folder / "rig.json", rig)


def paths(folder, out):
    """Arguments of the stage's `run`."""
    return {"capture": folder, "index": folder / "index", "rig": folder / "rig.json", "out": out}


def variant(folder, target):
    """A copy of a drawn capture whose files may be changed without changing the first one."""
    for path in folder.rglob("*"):
        if path.is_file():
            copy = target / path.relative_to(folder)
            copy.parent.mkdir(parents=True, exist_ok=True)
            copy.write_bytes(path.read_bytes())
    return target


def edit_json(path: Path, change):
    """Let `change` edit what a JSON file holds."""
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def light_images(folder, light):
    """Paths of the photographs of one light, or of the silhouettes for None."""
    return sorted(folder.glob(f"*_{light}.png" if light is None else f"*_{int(light[1:])}.png"))
