"""Keys of `capture.yaml` about images: those of the subject, and their masks."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, field_validator

from pipeline.capture.schema.sections import ImagePattern, MaskPattern, ParquetPath, PlatePattern, Section

ONE_NUMBER, THREE_NUMBERS = "one number", "three numbers"
"""Choices of a value's type. Spaces tell them from keys, beside which pydantic names them."""

Count = Annotated[float, Field(allow_inf_nan=False)]

BlackLevel = Annotated[
    Annotated[Count, Tag(ONE_NUMBER)] | Annotated[list[Count], Field(min_length=3, max_length=3), Tag(THREE_NUMBERS)],
    Discriminator(lambda level: THREE_NUMBERS if isinstance(level, list) else ONE_NUMBER),
]
"""Stored value of no light: of all channels, or of R, G and B."""


class Images(Section):
    """The images of the moving subject.

    A path that goes through a .zip file, as in `images/{camera}.zip/{frame:06d}.png`, names a member of that archive.
    In a table, one that goes through a video (.mp4, .mov, .avi, .mkv), as `images/cam1.mp4/000012`, names its frame,
    counted from 0; with `.red` behind it, its first channel, for masks.
    """

    table: ParquetPath | None = Field(
        None,
        description="in place of path, a parquet with a row for each image that there is: camera, frame, path, "
        "mask_path (null: no mask); .jpg and .avif files, too",
    )
    path: ImagePattern | None = Field(
        None,
        description="pattern with {camera} and {frame:06d}; .exr (R, G, B) or .png (8, 16 bit)",
        validate_default=True,
    )
    transfer: Literal["linear", "srgb", "gamma_2.2"] = Field(
        description="how stored values relate to light; gamma_2.2: a plain power, which is not sRGB"
    )
    black_level: BlackLevel = Field(
        description="stored value (counts, but for .exr) of no light, of all channels or a list of R, G and B; "
        "subtracted before anything else"
    )
    downsample_from_sensor: int = Field(ge=1, description="d: an image pixel is d x d sensor pixels")
    reduced: int = Field(
        1,
        ge=1,
        description="r: as images and masks are read, r x r stored pixels become one, the mean of their light; sizes "
        "in the table of cameras, and d, are those after it",
    )

    # `info` is pydantic's ValidationInfo: a protocol that run-time type checks cannot test for.
    @field_validator("path")
    @classmethod
    def _is_pattern_or_table(cls, path: str | None, info: Any) -> str | None:
        # A table that is itself wrong is not in `data`: it has its own complaint.
        if "table" in info.data and (path is None) == (info.data["table"] is None):
            raise ValueError("a pattern with {camera} and {frame:06d}, or else images.table, one of the two")
        return path


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
    clean_plates: PlatePattern | None = Field(
        None,
        description="in place of path, pattern with {camera}: the camera's image of the stage without the subject, "
        "fully lit, stored as images are; segment_subject masks fully lit frames by it",
    )
