"""Settings of packing."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from pipeline.config.settings import Settings

Codec = Literal["float32", "float16", "float16_lz4", "float16_zstd"]


class PackShards(Settings):
    """Cut of foreground crops."""

    codec: Codec = Field(
        "float16",
        description="how pixels are stored, and what compresses them: less to read, more to compute per image",
    )
    margin_px: int = Field(8, ge=0, description="Background kept around the foreground's box on each side [pixels]")
