"""Settings of export_capture."""

from __future__ import annotations

from pydantic import Field

from pipeline.config.settings import Settings


class ExportCapture(Settings):
    """Frames and brightness of a capture in the layouts of other programs."""

    frames: int = Field(0, ge=0, description="frames that are written, spread over all; 0: all [frames]")
    exposure: float = Field(
        1.0, gt=0, description="factor on linear light before it is stored in 8 bits; what exceeds 1 then is cut off"
    )
