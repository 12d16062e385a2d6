"""Settings of detect_landmarks."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from pipeline.config.settings import Settings


class DetectLandmarks(Settings):
    """Keypoints of photographs that come without any."""

    use: Literal["missing", "always", "never"] = Field(
        "missing",
        description="missing: for captures without keypoints_2d, if the detector is there (make detect); always: in "
        "place of the capture's; never: nowhere",
    )
    detector: str = Field(
        "",
        description="command of another detector, which is told what docs/detection.md says; empty: MediaPipe in "
        ".venv-detect",
    )
    frames: Literal["fully_lit", "all"] = Field(
        "fully_lit", description="frames that are looked at; the tracker carries the template through the others"
    )
    parts: tuple[Literal["body", "face", "hands"], ...] = Field(
        ("body", "face", "hands"), min_length=1, description="parts of a person that are looked for"
    )
    least_confidence: float = Field(
        0.5, ge=0, le=1, description="confidence of a person, a face or a hand below which there is none"
    )
