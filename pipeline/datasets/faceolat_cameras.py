"""Cameras of FaceOLAT: Metashape's export, whose chunk is laid over the dome of lights."""

from __future__ import annotations

import logging
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from pipeline.base.errors import Complaints, InputError
from pipeline.capture.cameras.metashape_cameras import read_metashape
from pipeline.capture.cameras.xml_documents import read_xml
from pipeline.geometry.cameras import Camera

log = logging.getLogger(__name__)

UNITS = {"metres": 1.0, "millimetres": 0.001}
"""Units that the chunk's transform may lead to."""

ON_DOME = (0.5, 2.0)
"""Distance of cameras from the dome's middle, over its radius: they stand between its lights, some outside, some in."""


def fitted_sphere(points: Float64[np.ndarray, "points 3"]) -> tuple[Float64[np.ndarray, " 3"], float]:
    """Centre and radius of the sphere nearest to points.

    By linear least squares of |x|^2 = 2 c x + r^2 - |c|^2.
    """
    rows = np.concatenate([2 * points, np.ones((len(points), 1))], axis=1)
    solution, *_ = np.linalg.lstsq(rows, (points**2).sum(1), rcond=None)
    center = solution[:3]
    return center, float(np.sqrt(max(solution[3] + center @ center, 0.0)))


def read_faceolat_cameras(
    file: Path, names: Collection[str], lights: Float64[np.ndarray, "lights 3"]
) -> tuple[dict[str, Camera], str]:
    """The calibrated cameras among `names`, and how their unit was found.

    They are in the frame of the lights, metres.

    Args:
        lights: where they are, metres.

    Raises:
        InputError: if the export has no transform of its chunk, or cameras are nowhere near the dome in any unit.
    """
    root = read_xml(file)
    if root.find("chunk/transform") is None and root.find("chunk/components/component/transform") is None:
        raise InputError(
            f"{file}: transform: expected that of the chunk, which leads into the frame of the lights, found none: the "
            "chunk's own scale is arbitrary; export the cameras of the set's calibration, which has it, or lay the "
            "chunk over the lights with three markers and export again"
        )
    complaints = Complaints(file)
    images = read_metashape(file, names, complaints)
    complaints.raise_if_any()
    cameras = {image.owner: image.camera for image in images if image.camera is not None}
    if not cameras:
        raise InputError(f"{file}: expected cameras Cam01 and so on that are aligned, found none")
    center, radius = fitted_sphere(lights)
    ratios = {
        unit: float(np.median([np.linalg.norm(scale * camera.center - center) for camera in cameras.values()]) / radius)
        for unit, scale in UNITS.items()
    }
    said = ", ".join(f"{ratio:.2f} radii in {unit}" for unit, ratio in ratios.items())
    log.info("%s: cameras are %s from the middle of the dome of lights (median), of radius %.3f m", file, said, radius)
    fits = [unit for unit, ratio in ratios.items() if ON_DOME[0] < ratio < ON_DOME[1]]
    if len(fits) != 1:
        raise InputError(
            f"{file}: transform: expected cameras {ON_DOME[0]:g} to {ON_DOME[1]:g} radii from the middle of the lights"
            f"' dome in one unit, found {said}; set the scale of the chunk's transform so that cameras are in metres"
        )
    scale = UNITS[fits[0]]
    note = f"chunk laid over the lights by its transform, which is in {fits[0]}: cameras are {said} from their middle"
    return {name: replace(camera, t=scale * camera.t) for name, camera in sorted(cameras.items())}, note
