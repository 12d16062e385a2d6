"""Settings of unwrap_atlas."""

from typing import Literal

from pydantic import Field

from pipeline.config.settings import Settings


class UnwrapAtlas(Settings):
    """Layout of the template's surface on a square map."""

    size: int = Field(256, ge=8, le=8192, description="texels per side of the map [texels]")
    layout: Literal["auto", "template", "new"] = Field(
        "auto", description="template: the template's own texture coordinates; new: cut by xatlas; auto: own if usable"
    )
    padding: int = Field(2, ge=0, le=64, description="empty texels between the charts of a new layout [texels]")
