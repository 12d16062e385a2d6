"""Studio in which the photographs of a capture are taken."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pipeline.config.synthesize_capture import SynthesizeCapture
from pipeline.synthesis.sensor_model import SensorModel
from pipeline.synthesis.stage_rig import StageRig


@dataclass(frozen=True)
class Studio:
    """Setting of every photograph: the capture's folder, its subject, rig and settings.

    Attributes:
        renderer: of frames; calibration targets are the same for all.
    """

    root: Path
    subject: str
    settings: SynthesizeCapture
    rig: StageRig
    renderer: Literal["scalar", "llvm"] = "scalar"

    @property
    def sensor_model(self) -> SensorModel:
        """The cameras' common noise."""
        s = self.settings
        return SensorModel(s.shot_gain, s.read_noise, s.saturation, s.black_level)
