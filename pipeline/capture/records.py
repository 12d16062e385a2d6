"""Records that training and evaluation work on: of an image crop, and of a frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64

from pipeline.base.splits import VALIDATION


@dataclass(frozen=True)
class ImageRecord:
    """One foreground crop, undistorted and colour-corrected.

    Attributes:
        test_camera, test_frame, test_segment, test_pattern: why the image is held out for testing.
        x0, y0: first pixel of the crop in the undistorted full image.
        image: linear RGB, black level removed.
        mask: share of the subject in each pixel, 0..1.
        K: intrinsics of the crop, first pixel centre (0.5, 0.5); no distortion is left.
        R, t: camera-from-world, metres.
        validation: choices are made on it; it trains when neither this nor any of the others is true.
    """

    camera: str
    frame: int
    test_camera: bool
    test_frame: bool
    test_segment: bool
    test_pattern: bool
    fully_lit: bool
    x0: int
    y0: int
    width: int
    height: int
    image: Float32[np.ndarray, "h w 3"]
    mask: Float32[np.ndarray, "h w"]
    K: Float64[np.ndarray, "3 3"]
    R: Float64[np.ndarray, "3 3"]
    t: Float64[np.ndarray, " 3"]
    validation: bool = False

    @property
    def is_test(self) -> bool:
        """True if this image is held out for testing."""
        return self.test_camera or self.test_frame or self.test_segment or self.test_pattern

    @property
    def split(self) -> str:
        """Split that this image belongs to: one that tests in any way neither trains nor validates."""
        if self.is_test:
            return "test"
        return VALIDATION if self.validation else "train"


@dataclass(frozen=True)
class FrameRecord:
    """Data that all images of one frame share.

    Attributes:
        vertices: posed template, glTF vertex order, metres.
        irradiance: visible share of the light at each texel, about 0..1 (single samples may exceed 1).
        cosine_visibility: the same share weighted by the cosine, i.e. of the light that falls on a matte surface.
        light_positions: lit lights only, stage frame, metres.
        light_intensities: radiant intensity of each, linear RGB.
        head_from_world: of a head, the rigid motion [R | t] that brings points (R x + t, metres) and directions (R x)
            to the frame of the template at rest; None for a body.
        gaze: unit direction in which each eye looks, by name, in that frame; None if the capture declares none.
        texture: mean colour of each texel in the nearest fully lit frames, linear RGB; None if none was baked.
    """

    frame: int
    segment: str
    fully_lit: bool
    vertices: Float32[np.ndarray, "vertices 3"]
    irradiance: Float32[np.ndarray, " texels"]
    cosine_visibility: Float32[np.ndarray, " texels"]
    light_positions: Float32[np.ndarray, "lights 3"]
    light_intensities: Float32[np.ndarray, "lights 3"]
    head_from_world: Float32[np.ndarray, "3 4"] | None = None
    gaze: Float32[np.ndarray, "eyes 3"] | None = None
    texture: Float32[np.ndarray, "texels 3"] | None = None
