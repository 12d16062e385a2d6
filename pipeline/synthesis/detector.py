"""Synthetic keypoint detector: projections with noise and outliers.

Hidden keypoints have more noise and less confidence.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float64

from pipeline.geometry.cameras import Camera

HIDDEN_NOISE = 3.0
"""A hidden keypoint is guessed, with this many times the noise of a visible one."""

OUTLIER_PX = 20.0
"""Error of an outlier at an image height of 160 pixels: about a limb mistaken for another."""

VISIBLE_CONFIDENCE, HIDDEN_CONFIDENCE, OUTLIER_CONFIDENCE = 0.9, 0.45, 0.55
CONFIDENCE_SPREAD = 0.06


def detect_keypoints(
    camera: Camera,
    keypoints: Float64[np.ndarray, "keypoints 3"],
    hidden: Bool[np.ndarray, " keypoints"],
    names: tuple[str, ...],
    noise_px: float,
    outlier_share: float,
    random: np.random.Generator,
) -> pd.DataFrame:
    """Table of detections: keypoint, x, y (pixels of the distorted image), confidence.

    Args:
        camera: at image resolution.
        hidden: keypoints that something else than their own skin covers.
    """
    pixels, _ = camera.project(keypoints)
    spread = noise_px * np.where(hidden, HIDDEN_NOISE, 1.0)
    pixels = pixels + spread[:, None] * random.standard_normal(pixels.shape)
    outlier = random.random(len(keypoints)) < outlier_share
    turn = 2 * np.pi * random.random(len(keypoints))
    far = OUTLIER_PX * camera.height / 160 * (0.5 + random.random(len(keypoints)))
    pixels = pixels + np.where(outlier, far, 0.0)[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    confidence = np.where(hidden, HIDDEN_CONFIDENCE, VISIBLE_CONFIDENCE)
    confidence = np.where(outlier, OUTLIER_CONFIDENCE, confidence)
    confidence = (confidence + CONFIDENCE_SPREAD * random.standard_normal(len(keypoints))).clip(0.05, 1.0)
    return pd.DataFrame({"keypoint": names, "x": pixels[:, 0], "y": pixels[:, 1], "confidence": confidence})
