"""Writing a recording as a COLMAP project: a model with one rig, images and masks.

`images/CAMERA/FRAME.png` is the layout of COLMAP's rig support, and `masks/CAMERA/FRAME.png.png` where its feature
extraction looks for a mask of that image; it ignores what is 0 there.
"""

from __future__ import annotations

from pathlib import Path

from pipeline.export.picture_folders import image_name, write_pictures
from pipeline.export.recording import Recording

MODEL = "sparse/0"


def write_colmap_folder(folder: Path, recording: Recording, exposure: float) -> None:
    """Write the model to `MODEL`, binary, with lenses as they are: no image is undistorted."""
    # Imports pycolmap, which loads all of COLMAP.
    from pipeline.capture.cameras.colmap_cameras import write_colmap_rig

    images = {
        int(frame): {str(camera): image_name(str(camera), int(frame)) for camera in rows.camera}
        for frame, rows in recording.images.groupby("frame")
    }
    write_colmap_rig(folder / MODEL, recording.cameras, images)
    write_pictures(folder, recording, exposure, lambda name: f"{name}.png")
