"""Types of the keys of `capture.yaml`: strict sections, lengths, paths with placeholders."""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from pipeline.capture.paths import check_pattern, check_relative, check_suffix
from pipeline.capture.video_frames import VIDEO_SUFFIXES

EXR_OR_PNG = (".exr", ".png")
OPENCV_IMAGE = (".png", ".jpg", ".jpeg", ".tif", ".tiff")

Length = Annotated[float, Field(gt=0, allow_inf_nan=False)]


def path_to(*suffixes: str) -> AfterValidator:
    """Checks a relative path to a file of one of these kinds."""
    return AfterValidator(lambda path: check_suffix(check_relative(path), suffixes))


def pattern_with(*placeholders: str, suffixes: tuple[str, ...]) -> AfterValidator:
    """Checks a relative path with these placeholders to files of one of these kinds."""
    return AfterValidator(lambda path: check_suffix(check_pattern(check_relative(path), placeholders), suffixes))


def _board_pattern(path: str) -> str:
    relative = check_relative(path)
    if PurePosixPath(relative).suffix.lower() in VIDEO_SUFFIXES:
        return check_pattern(relative, ("camera",))
    return check_suffix(check_pattern(relative, ("camera", "view")), OPENCV_IMAGE)


CsvPath = Annotated[str, path_to(".csv")]
ParquetPath = Annotated[str, path_to(".parquet")]
ImagePattern = Annotated[str, pattern_with("camera", "frame", suffixes=EXR_OR_PNG)]
MaskPattern = Annotated[str, pattern_with("camera", "frame", suffixes=(".png",))]
BoardPattern = Annotated[str, AfterValidator(_board_pattern)]
BallPattern = Annotated[str, pattern_with("position", "camera", "light", suffixes=OPENCV_IMAGE)]
SilhouettePattern = Annotated[str, pattern_with("position", "camera", suffixes=OPENCV_IMAGE)]
PlatePattern = Annotated[str, pattern_with("camera", suffixes=EXR_OR_PNG)]
ChartPattern = Annotated[str, pattern_with("camera", suffixes=(".exr", *OPENCV_IMAGE))]


class Section(BaseModel):
    """Immutable; types are taken at their word ("3" is no number); an unknown key is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class Spectra(Section):
    """Spectra of lights that differ in colour, and what cameras see of each wavelength."""

    lights: CsvPath = Field(description="csv: light, wavelength_nm, power; a spectrum of each light, in any one unit")
    sensitivities: CsvPath = Field(
        description="csv: wavelength_nm, r, g, b; what the cameras' channels see, in any unit: a light's intensities "
        "are multiplied by what each channel sees of it, over the mean of all lights"
    )
