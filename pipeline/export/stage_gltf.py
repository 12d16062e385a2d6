"""Cameras and lights of the stage as glTF, lights by the extension KHR_lights_punctual.

A glTF camera has neither distortion nor a principal point off the middle of its picture: its extras have them, as
calibrated. Radiant intensities stand where glTF wants candela: their ratios are right, their unit is the capture's own.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pygltflib
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from pipeline.export.glb import GlbFile
from pipeline.geometry.cameras import Camera
from pipeline.lighting.named_lights import NamedLights

LIGHTS = "KHR_lights_punctual"
NEAR_M, FAR_M = 0.01, 100.0

GL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0])
"""Axes of a camera of glTF and USD, y up and z backward, from those of OpenCV; its own inverse."""


def write_stage_glb(path: Path, cameras: Mapping[str, Camera], lights: NamedLights) -> None:
    """Write a .glb with a node for each camera and light, called as it is."""
    file = GlbFile()
    for index, (name, camera) in enumerate(cameras.items()):
        file.document.cameras.append(perspective(name, camera))
        x, y, z, w = Rotation.from_matrix(world_from_gl_camera(camera)).as_quat()
        file.add_node(
            pygltflib.Node(name=name, camera=index, translation=camera.center.tolist(), rotation=[x, y, z, w])
        )
    file.use(LIGHTS)
    described = []
    for index, (name, position, rgb) in enumerate(zip(lights.names, lights.positions, lights.intensities, strict=True)):
        strength, color = split_intensity(rgb)
        described.append({"name": name, "type": "point", "color": color.tolist(), "intensity": strength})
        file.add_node(pygltflib.Node(name=name, translation=position.tolist(), extensions={LIGHTS: {"light": index}}))
    file.document.extensions[LIGHTS] = {"lights": described}
    file.write(path)


def perspective(name: str, camera: Camera) -> pygltflib.Camera:
    """The lens, its picture's shape, and what glTF has no key for as extras."""
    (_, _, _), (_, fy, _), _ = camera.K.tolist()
    calibrated = {
        "K": camera.K.tolist(), "distortion": dict(zip(camera.lens.terms, camera.dist.tolist(), strict=True)),
        "lens": camera.lens.name, "width": camera.width, "height": camera.height,
    }  # fmt: skip
    return pygltflib.Camera(
        name=name, type="perspective", extras=calibrated,
        perspective=pygltflib.Perspective(
            yfov=2 * float(np.arctan(0.5 * camera.height / fy)), aspectRatio=camera.width / camera.height,
            znear=NEAR_M, zfar=FAR_M,
        ),
    )  # fmt: skip


def world_from_gl_camera(camera: Camera) -> Float64[np.ndarray, "3 3"]:
    """Rotation of a camera that looks along its -z, y up."""
    return camera.R.T @ GL_FROM_OPENCV


def split_intensity(rgb: Float64[np.ndarray, " 3"]) -> tuple[float, Float64[np.ndarray, " 3"]]:
    """A strength, and a colour whose brightest channel is 1."""
    strength = float(rgb.max())
    return strength, rgb / strength if strength > 0 else np.ones(3)
