"""Settings of packing."""

from __future__ import annotations

from pydantic import Field

from pipeline.config.settings import Settings


class PackShards(Settings):
    """How foreground crops are cut."""

    margin_px: int = Field(8, ge=0, description="Background kept around the foreground's box on each side [pixels]")
