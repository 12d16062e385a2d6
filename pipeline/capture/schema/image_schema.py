"""Keys of `capture.yaml` about images: those of the subject, and their masks."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, field_validator

from pipeline.capture.schema.sections import ImagePattern, MaskPattern, ParquetPath, Section

ChannelLevels = Annotated[list[Annotated[float, Field(allow_inf_nan=False)]], Field(min_length=3, max_length=3)]
"""Stored values of no light, of R, G and B."""


class Images(Section):
    """The images of the moving subject.

    A path that goes through a .zip file, as in `images/{camera}.zip/{frame:06d}.png`, names a member of that archive.
    """

    path: ImagePattern | None = Field(
        None, description="pattern with {camera} and {frame:06d}; .exr (R, G, B) or .png (8, 16 bit)"
    )
    table: ParquetPath | None = Field(
        None,
        description="in place of a pattern, a parquet with a row for each image that there is: camera, frame, path, "
        "mask_path (null: no mask); .jpg and .avif files, too",
        validate_default=True,
    )
    transfer: Literal["linear", "srgb"] = Field(description="how stored values relate to light")
    black_level: Annotated[float, Field(allow_inf_nan=False)] | ChannelLevels = Field(
        description="stored value (counts, but for .exr) of no light, of all channels or a list of R, G and B; "
        "subtracted before anything else"
    )
    downsample_from_sensor: int = Field(ge=1, description="d: an image pixel is d x d sensor pixels")

    # `info` is pydantic's ValidationInfo: a protocol that run-time type checks cannot test for.
    @field_validator("table")
    @classmethod
    def _is_pattern_or_table(cls, table: str | None, info: Any) -> str | None:
        # A pattern that is itself wrong is not in `data`: it has its own complaint.
        if "path" in info.data and (table is None) == (info.data["path"] is None):
            raise ValueError("either images.path, a pattern, or images.table, one of the two")
        return table


class Masks(Section):
    """Masks of the pixels that show the subject."""

    path: MaskPattern | None = Field(
        None,
        description="pattern with {camera} and {frame:06d}; one channel, 8 bit, 255 = subject. Not with images.table, "
        "which names the masks",
    )
    labels: list[int] | None = Field(
        None, description="values that are the subject, of masks that number parts; left out: 255 is the subject"
    )
    enlarged: bool = Field(False, description="true: masks may be a whole factor smaller than their images")
