"""Settings of unwrap_atlas."""

from typing import Literal

from pydantic import Field

from pipeline.config.settings import Settings


class UnwrapAtlas(Settings):
    """Layout of the template's surface on a square map."""

    size: int | None = Field(
        None, ge=8, le=8192, description="texels per side of the map; null: as texel_pixels asks for [texels]"
    )
    texel_pixels: float = Field(
        0.6, gt=0, description="side of a texel over what a pixel covers at the subject, where size is null"
    )
    most: int = Field(
        320, ge=8, le=8192, description="texels per side at most, where size is null: they cost time [texels]"
    )
    layout: Literal["auto", "template", "new"] = Field(
        "auto", description="template: the template's own texture coordinates; new: cut by xatlas; auto: own if usable"
    )
    padding: int = Field(2, ge=0, le=64, description="empty texels between the charts of a new layout [texels]")
