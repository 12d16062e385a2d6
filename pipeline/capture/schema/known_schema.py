"""The keys of `calibration.cameras` with `method: known`."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, field_validator

from pipeline.capture.paths import check_relative, check_suffix
from pipeline.capture.schema.sections import Length, Section


class KnownCameras(Section):
    """Cameras were calibrated elsewhere."""

    method: Literal["known"] = Field(description="which method this section is about")
    format: Literal["cameras_json", "colmap", "nerfstudio"] = Field(
        "cameras_json",
        description="cameras_json: R, t, K, dist, width, height per camera; colmap: the folder of a sparse model, text "
        "or binary; nerfstudio: a transforms.json. All at sensor resolution",
    )
    path: Annotated[str, AfterValidator(check_relative)] = Field(
        description="the .json file, or the folder of a COLMAP model"
    )
    scale_to_m: Length = Field(1.0, description="a length in metres is this times a length in the file")
    frame: Literal["stage", "own"] = Field(
        "stage",
        description="stage: that of the surveyed lights; own: any other, which mirror-ball images then lay over the "
        "stage's by turning and shifting it",
    )

    # `info` is pydantic's ValidationInfo: a protocol that run-time type checks cannot test for.
    @field_validator("path")
    @classmethod
    def _is_of_the_format(cls, path: str, info: Any) -> str:
        return path if info.data.get("format") == "colmap" else check_suffix(path, (".json",))
