"""Sensor model: colour response per camera, shot and read noise, saturation, files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float32, Float64, UInt8


@dataclass(frozen=True)
class SensorModel:
    """Noise and range of a sensor, in units of linear image values.

    The variance of the noise is shot_gain * signal + read_noise^2 (Poisson shot noise).

    Attributes:
        saturation: largest value before the black level is added.
        black_level: value of a pixel that receives no light.
    """

    shot_gain: float
    read_noise: float
    saturation: float
    black_level: float

    def expose(
        self,
        radiance: Float32[np.ndarray, "h w 3"],
        raw_from_true: Float64[np.ndarray, "3 3"],
        random: np.random.Generator,
    ) -> Float32[np.ndarray, "h w 3"]:
        """Radiance (linear RGB) to raw values with noise."""
        signal = radiance.astype(np.float64) @ raw_from_true.T
        deviation = np.sqrt(self.shot_gain * np.maximum(signal, 0.0) + self.read_noise**2)
        raw = signal + deviation * random.standard_normal(signal.shape)
        return (np.minimum(raw, self.saturation) + self.black_level).astype(np.float32)

    def expose_gray(self, values: np.ndarray, random: np.random.Generator) -> UInt8[np.ndarray, "h w"]:
        """Linear grey values in [0, 1] to 8 bits, with noise, for calibration images."""
        deviation = np.sqrt(self.shot_gain * np.maximum(values, 0.0) + self.read_noise**2)
        noisy = values + deviation * random.standard_normal(values.shape)
        return np.rint(255 * noisy.clip(0.0, 1.0)).astype(np.uint8)


def write_8bit(path: Path, image: UInt8[np.ndarray, "h w"], jpeg_quality: int = 95) -> None:
    """Write a grey image as PNG or JPEG, by suffix.

    Raises:
        OSError: if the file cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    flags = [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality] if path.suffix == ".jpg" else []
    if not cv2.imwrite(str(path), image, flags):
        raise OSError(f"cannot write {path}")
