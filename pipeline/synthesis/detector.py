"""A synthetic keypoint detector: projected joints with noise, outliers, and less confidence where they are hidden."""

from __future__ import annotations

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float64

from pipeline.geometry.cameras import Camera

SKIN_DEPTH_M = 0.16
"""A joint lies up to this far below the skin that belongs to it (half the torso's width); more means it is hidden."""

HIDDEN_NOISE = 3.0
"""A hidden joint is guessed, with this many times the noise of a visible one."""

OUTLIER_PX = 20.0
"""Outliers are off by about this much at an image height of 160 pixels: a limb mistaken for another."""

VISIBLE_CONFIDENCE, HIDDEN_CONFIDENCE, OUTLIER_CONFIDENCE = 0.9, 0.45, 0.55
CONFIDENCE_SPREAD = 0.06


def detect_keypoints(
    camera: Camera,
    joints: Float64[np.ndarray, "joints 3"],
    hidden: Bool[np.ndarray, "joints"],
    names: tuple[str, ...],
    noise_px: float,
    outlier_share: float,
    random: np.random.Generator,
) -> pd.DataFrame:
    """keypoint, x, y, confidence of every joint, in the pixels of the distorted image.

    Args:
        camera: at image resolution.
        hidden: joints that something else than their own limb covers.
    """
    pixels, _ = camera.project(joints)
    spread = noise_px * np.where(hidden, HIDDEN_NOISE, 1.0)
    pixels = pixels + spread[:, None] * random.standard_normal(pixels.shape)
    outlier = random.random(len(joints)) < outlier_share
    turn = 2 * np.pi * random.random(len(joints))
    far = OUTLIER_PX * camera.height / 160 * (0.5 + random.random(len(joints)))
    pixels = pixels + np.where(outlier, far, 0.0)[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    confidence = np.where(hidden, HIDDEN_CONFIDENCE, VISIBLE_CONFIDENCE)
    confidence = np.where(outlier, OUTLIER_CONFIDENCE, confidence)
    confidence = (confidence + CONFIDENCE_SPREAD * random.standard_normal(len(joints))).clip(0.05, 1.0)
    return pd.DataFrame({"keypoint": names, "x": pixels[:, 0], "y": pixels[:, 1], "confidence": confidence})
