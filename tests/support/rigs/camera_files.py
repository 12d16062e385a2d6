"""Two cameras that look at the stage, as other programs write them, and how they are read."""

from __future__ import annotations

import numpy as np
import pycolmap
import pytest

from pipeline.base.errors import Complaints
from pipeline.capture.cameras.known_cameras import read_known_cameras
from pipeline.capture.schema.camera_schema import KnownCameras

SIZE = (640, 480)
SIZES = {"cam00": SIZE, "cam01": SIZE}
SAME_PX = 1e-6
CENTERS = {"cam00": np.array([0.3, 1.5, 2.0]), "cam01": np.array([-1.9, 0.8, 0.4])}
POINTS = np.array([0.0, 1.0, 0.0]) + np.random.default_rng(0).uniform(-0.3, 0.3, (50, 3))
"""Metres, about the middle of the stage."""

LENSES = {
    "SIMPLE_PINHOLE": [500.0, 310.0, 250.0],
    "PINHOLE": [500.0, 510.0, 310.0, 250.0],
    "SIMPLE_RADIAL": [500.0, 310.0, 250.0, -0.12],
    "RADIAL": [500.0, 310.0, 250.0, -0.12, 0.05],
    "OPENCV": [500.0, 510.0, 310.0, 250.0, -0.12, 0.05, 0.002, -0.003],
    "FULL_OPENCV": [500.0, 510.0, 310.0, 250.0, -0.12, 0.05, 0.002, -0.003, 0.01, 0.0, 0.0, 0.0],
    "SIMPLE_FISHEYE": [300.0, 310.0, 250.0],
    "FISHEYE": [300.0, 305.0, 310.0, 250.0],
    "SIMPLE_RADIAL_FISHEYE": [300.0, 310.0, 250.0, -0.04],
    "RADIAL_FISHEYE": [300.0, 310.0, 250.0, -0.04, 0.01],
    "OPENCV_FISHEYE": [300.0, 305.0, 310.0, 250.0, -0.04, 0.01, -0.004, 0.0006],
}


def looking_at_the_stage(center):
    """Rows right, down, forward of a camera, with some roll."""
    forward = np.array([0.0, 1.0, 0.0]) - center
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.1, 1.0, 0.05])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def read(folder, sizes=SIZES, **keys):
    """The cameras, and what is complained of."""
    complaints = Complaints(folder)
    section = KnownCameras.model_validate({"method": "known", **keys})
    return read_known_cameras(folder, section, sizes, complaints), "\n".join(complaints.messages)


def model(lens="OPENCV", images=None, unit_m=1.0, params=None, size=SIZE):
    """A COLMAP model of both cameras, one image each or as `images` says.

    `images` maps a name to (camera, offset of the centre).
    """
    images = images or {f"{name}.png": (name, np.zeros(3)) for name in SIZES}
    made, ids = pycolmap.Reconstruction(), {name: k for k, name in enumerate(SIZES, 1)}
    for k in ids.values():
        made.add_camera_with_trivial_rig(
            pycolmap.Camera(camera_id=k, model=lens, width=size[0], height=size[1], params=params or LENSES[lens])
        )
    for key, (name, (owner, offset)) in enumerate(images.items(), 1):
        R = looking_at_the_stage(CENTERS[owner])
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(R), -R @ (CENTERS[owner] + offset) / unit_m)
        made.add_image_with_trivial_frame(pycolmap.Image(name=name, camera_id=ids[owner], image_id=key), pose)
    return made


def write_model(folder, made, kind="binary"):
    folder.mkdir(parents=True, exist_ok=True)
    getattr(made, f"write_{kind}")(folder)


def same_projections(cameras, made, unit_m=1.0):
    for image in made.images.values():
        in_camera = POINTS / unit_m @ image.cam_from_world().rotation.matrix().T + image.cam_from_world().translation
        expected = image.camera.img_from_cam(in_camera)
        pixels, depth = cameras[image.name.split(".")[0]].project(POINTS)
        assert np.abs(pixels - expected).max() < SAME_PX
        assert depth == pytest.approx(in_camera[:, 2] * unit_m)
