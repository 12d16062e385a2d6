"""Settings of bake_textures."""

from __future__ import annotations

from pydantic import Field

from pipeline.config.settings import Settings


class BakeTextures(Settings):
    """Averaging of what cameras see of a texel."""

    cosine_power: float = Field(
        1.0, ge=0, le=16, description="a camera counts by this power of the cosine between its view and the normal"
    )
