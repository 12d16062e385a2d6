"""Settings of indexing a capture."""

from __future__ import annotations

from pydantic import Field

from pipeline.config.settings import Settings


class IndexCapture(Settings):
    """Reading of a capture; nothing here changes the result."""

    decode_threads: int = Field(4, ge=1, le=256, description="Images decoded at once while they are checked [threads]")
