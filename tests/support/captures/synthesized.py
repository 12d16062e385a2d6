"""Small captures as synthesize_capture makes them, and their truth at image resolution."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pipeline.base.files import read_arrays
from pipeline.config.synthesize_capture import SynthesizeCapture
from pipeline.geometry.cameras import Camera, read_cameras
from pipeline.stages.synthesize_capture import run


def synthesize(out: Path, settings: SynthesizeCapture) -> Path:
    """Make the capture `small` by one worker; returns its folder."""
    run(subject="small", out=out, workers=1, settings=settings)
    return out


def read_truth(capture: Path, settings: SynthesizeCapture) -> tuple[dict[str, Camera], dict[str, np.ndarray]]:
    """True cameras at the resolution of the images, and the true poses."""
    cameras = read_cameras(capture / "truth/cameras.json")
    images = {name: camera.downsampled(settings.downsample_from_sensor) for name, camera in cameras.items()}
    return images, read_arrays(capture / "truth/tracking.safetensors")
