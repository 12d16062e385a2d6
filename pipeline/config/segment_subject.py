"""Settings of segment_subject."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from pipeline.config.settings import Settings


class SegmentSubject(Settings):
    """Masks of photographs that come without any."""

    use: Literal["missing", "always", "never"] = Field(
        "missing",
        description="missing: for captures with clean plates, and for those without masks if the detector is there "
        "(make detect); always: in place of the capture's; never: nowhere",
    )
    detector: str = Field(
        "",
        description="command of another detector, which is told what docs/detection.md says; empty: MediaPipe in "
        ".venv-detect; captures with clean plates need none",
    )
    frames: Literal["fully_lit", "all"] = Field(
        "fully_lit", description="frames that get a mask; clean plates, which are fully lit, fit no others"
    )
