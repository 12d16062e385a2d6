"""Keys of `calibration.cameras` without any board: what the subject shows by itself."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field, field_validator

from pipeline.capture.schema.camera_schema import CameraFile
from pipeline.capture.schema.sections import Length, Section


class CameraDistance(Section):
    """Distance of two cameras' centres, which gives a rig without boards its size."""

    first: str = Field(description="name of a camera")
    second: str = Field(description="name of another")
    metres: Length = Field(description="distance of their entrance pupils, about the middles of their lenses")


class FeatureCameras(Section):
    """Cameras are calibrated from the subject's own features, without any board.

    They are points that neighbouring cameras see alike in fully lit frames that are not held out, within the masks if
    there are any. All cameras stand still. Neighbours have to be near, some 15 to 20 degrees apart, and the subject
    textured. Where no distance is given, the mirror ball of calibration.lights gives the rig its size, and the surveyed
    lights correct it.
    """

    method: Literal["features"] = Field(description="which method this section is about")
    intrinsics: Literal["estimate", "refine", "known"] = Field(
        "estimate",
        description="estimate: a focal length and k1 are found for each camera; refine: those of lenses_from are where "
        "the focal lengths start; known: they stay as they are",
    )
    lenses_from: CameraFile | None = Field(
        None, description="lenses for refine or known, whose poses do not count", validate_default=True
    )
    distance: CameraDistance | None = Field(None, description="a distance that was measured")

    # `info` is pydantic's ValidationInfo: a protocol that run-time type checks cannot test for.
    @field_validator("lenses_from")
    @classmethod
    def _is_given_if_needed(cls, lenses: CameraFile | None, info: Any) -> CameraFile | None:
        use = info.data.get("intrinsics", "estimate")
        if use != "estimate" and lenses is None:
            raise ValueError(f"a file of lenses, format and path, for intrinsics: {use}")
        if use == "estimate" and lenses is not None and "intrinsics" in info.data:
            raise ValueError("no lenses for intrinsics: estimate (or say intrinsics: refine or known)")
        return lenses
