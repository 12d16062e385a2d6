"""Settings of export_viewer."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from pipeline.config.settings import Settings


class ExportViewer(Settings):
    """Contents of the page that relights an avatar in a browser."""

    timeline_frames: int = Field(
        12,
        ge=1,
        description="tracked frames on the timeline, spread over all; fewer where page_mb asks for it [frames]",
    )
    captured_cameras: int = Field(
        4, ge=0, description="cameras whose captured pictures can be shown beside the avatar [cameras]"
    )
    code_axes: int = Field(
        2, ge=0, description="heads: sliders of expression, along the axes in which the frames' codes differ most"
    )
    slider_steps: Literal[1, 3, 5, 7, 9] = Field(
        3,
        description="heads: poses along a slider of expression or gaze that are placed and traced, one in the middle; "
        "the page adds up what lies between; 1: no sliders",
    )
    page_mb: float = Field(30.0, gt=1, description="largest size of the page [MB]")
