"""Settings of the review of the tracking."""

from __future__ import annotations

from pydantic import Field

from pipeline.config.settings import Settings


class ReviewTracking(Settings):
    """Extent of the pictures and the recording of the tracking."""

    most_cameras: int = Field(
        24,
        ge=1,
        le=200,
        description="Cameras with a sheet of their own: the worst, and others evenly chosen [cameras]",
    )
    sheet_frames: int = Field(10, ge=1, le=100, description="Frames on a camera's sheet, evenly chosen [frames]")
    outlier_px: float = Field(
        3.0,
        gt=0,
        description="Keypoints detected further than this from the template's are shown as wrong [image px]",
    )
    recording: bool = Field(True, description="Whether to write tracking.rrd, for the viewer of rerun-sdk")
    recording_cameras: int = Field(16, ge=1, description="At most this many cameras in the recording, evenly chosen")
    recording_size_px: int = Field(320, ge=16, description="Longer side of the recording's images [px]")
    recording_jpeg_quality: int = Field(80, ge=1, le=100, description="Of the recording's images")
    recording_mb: float = Field(
        25.0, gt=0, description="About how large the recording may be: with more frames, some are left out, evenly [MB]"
    )
