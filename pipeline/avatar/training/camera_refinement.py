"""Poses of the cameras, refined on training images with the avatar as it is.

How a picture changes as its camera moves follows from its own slopes and the depth of its pixels, so one step of least
squares needs one picture of each image. Frames are dealt into two halves; where motions fitted to one half do not
bring down the error of the other, by little at least, cameras are left as calibrated.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pipeline.avatar.frames.camera_offsets import CAMERAS_AS_CALIBRATED, CameraOffsets
from pipeline.avatar.training.light_refinement import LEAST_SHARE, Sigmas
from pipeline.avatar.training.picture_equations import TIGHTER, PictureEquations


def refined_cameras(cameras: Mapping[str, PictureEquations], sigmas: Sigmas) -> tuple[CameraOffsets, float]:
    """Motions of cameras, and the share of squared errors that halves of the frames foretell.

    Cameras stay as calibrated, if that is little.

    Args:
        cameras: equations of `CameraOffsets.motions`, by name.
        sigmas: typical changes to expect.
    """
    stated = np.repeat([sigmas.turn, sigmas.shift_m], 3)
    tried = [stated / divisor for divisor in TIGHTER]
    foretold = [sum(equations.foretold(sigma) for equations in cameras.values()) for sigma in tried]
    best, errors = int(np.argmax(foretold)), sum(float(equations.errors.sum()) for equations in cameras.values())
    share = foretold[best] / errors if errors > 0 else 0.0
    if not share > LEAST_SHARE:
        return CAMERAS_AS_CALIBRATED, share
    motions = [equations.solve([0, 1], tried[best]) for equations in cameras.values()]
    return CameraOffsets(list(cameras), np.array(motions)), share
