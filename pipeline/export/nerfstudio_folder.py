"""Writing a recording as nerfstudio's transforms.json, images and masks.

Poses are world-from-camera, x right, y up, looking along -z; the world is the stage's, metres, y up, without
`applied_transform`. Every frame of the file has its own intrinsics; the model of the lens is one for all.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pipeline.base.errors import InputError
from pipeline.base.files import write_json
from pipeline.export.picture_folders import image_name, write_pictures
from pipeline.export.recording import Recording
from pipeline.geometry.cameras import Camera
from pipeline.geometry.lenses import BROWN_CONRADY, FISHEYE

MODELS = {BROWN_CONRADY: "OPENCV", FISHEYE: "OPENCV_FISHEYE"}

OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0])


def write_nerfstudio_folder(folder: Path, recording: Recording, exposure: float) -> None:
    """Write the files, lenses as they are.

    Raises:
        InputError: if the cameras have different models of lenses, which one file cannot say.
    """
    models = {name: MODELS[camera.lens] for name, camera in recording.cameras.items()}
    if len(set(models.values())) > 1:
        found = ", ".join(f"{model} of {name}" for name, model in models.items())
        raise InputError(f"layout nerfstudio: expected one model of lens for all cameras, found {found}; export colmap")
    known = {name: _lens(camera) for name, camera in recording.cameras.items()}
    frames = []
    for row in recording.images.itertuples():
        name = image_name(str(row.camera), row.frame)
        mask = {} if pd.isna(row.mask_path) else {"mask_path": f"masks/{name}"}
        frames.append({"file_path": f"images/{name}", **mask, **known[str(row.camera)]})
    write_pictures(folder, recording, exposure, lambda name: name)
    write_json(folder / "transforms.json", {"camera_model": next(iter(models.values())), "frames": frames})


def _lens(camera: Camera) -> dict[str, Any]:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = camera.R.T @ OPENGL_FROM_OPENCV, camera.center
    K = camera.K
    return {
        "w": camera.width, "h": camera.height, "fl_x": K[0, 0], "fl_y": K[1, 1], "cx": K[0, 2], "cy": K[1, 2],
        **dict(zip(camera.lens.terms, camera.dist.tolist(), strict=True)), "transform_matrix": pose.tolist(),
    }  # fmt: skip
