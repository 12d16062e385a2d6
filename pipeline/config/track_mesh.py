"""Settings of the stage track_mesh."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from pipeline.config.settings import Settings

Axis = Literal["x", "y", "z", "negative_x", "negative_y", "negative_z"]


class TrackMesh(Settings):
    """Fit of poses to keypoints and masks."""

    inlier_px: float = Field(
        3.0, gt=0, description="keypoints further than this from their triangulated point are outliers [image px]"
    )
    min_keypoints: int = Field(3, ge=3, description="frames with fewer triangulated keypoints are interpolated")
    rotation_acceleration: float = Field(
        30.0, gt=0, description="typical angular acceleration of a joint; less is smoother [rad/s^2]"
    )
    translation_acceleration: float = Field(
        10.0, gt=0, description="typical acceleration of the whole subject; less is smoother [m/s^2]"
    )
    rest_rotation: float = Field(
        1.0, gt=0, description="typical rotation of a joint away from the rest pose; much larger ones are allowed [rad]"
    )
    hinges: dict[str, Axis] = Field(
        {},
        description="joints of the template that only bend, one way, as elbows do, and about which axis of their frame",
    )
    max_iterations: int = Field(30, ge=1, description="Gauss-Newton steps per solve; it mostly converges in ten")
    outline_rounds: int = Field(
        5, ge=0, description="rounds of fitting outlines to masks; 0: keypoints alone, heads and hands stay stiff"
    )
    outline_sigma_px: float = Field(0.5, gt=0, description="standard deviation of a mask's outline [mask px]")
    outline_vertices: int = Field(600, ge=1, description="vertices, spread evenly, that may sit on an outline")
    outline_cameras: int = Field(24, ge=1, description="at most this many cameras' masks are used, evenly chosen")
    outline_size_px: int = Field(512, ge=16, description="longer side to which masks are reduced [px]")
    mask_gap_frames: int = Field(
        0,
        ge=0,
        description="outlines are interpolated between masks this near, for slow motion; 0: never [frames]",
    )
    interpolated_sigma_px: float = Field(
        2.0, gt=0, description="standard deviation of an interpolated outline [mask px]"
    )
    image_rounds: int = Field(
        3, ge=0, description="rounds of comparing colours between fully lit frames, at each blur; 0: no refinement"
    )
    image_points: int = Field(1500, ge=1, description="points of the surface whose colours are compared")
    image_frames: int = Field(
        32, ge=2, description="at most this many fully lit frames of a chunk are refined, evenly chosen"
    )
    image_cameras: int = Field(24, ge=1, description="at most this many cameras' images are used, evenly chosen")
    image_size_px: int = Field(512, ge=16, description="longer side to which images are reduced [px]")
    image_redundancy: float = Field(
        25.0, gt=0, description="colours that count as one: neighbours share a shadow's edge, a highlight, a blur"
    )
    offset_m: float = Field(
        0.01, ge=0, description="typical offset of a vertex from the posed template, in refined frames; 0: none [m]"
    )
    deformation_modes: int = Field(
        200, ge=0, description="waves of an unrigged template's surface that offsets consist of; 0: it moves rigidly"
    )
    deformation_m: float = Field(
        0.003, gt=0, description="typical offset of an unrigged template's surface from its rest shape [m]"
    )
    deformation_length_m: float = Field(
        0.03, gt=0, description="distance on the surface over which offsets become independent [m]"
    )
    deformation_time_s: float = Field(0.05, gt=0, description="time over which offsets change; more is smoother [s]")
    deformation_still_m: float = Field(
        0.0005, gt=0, description="what moves less than this in every frame is taken for still [m]"
    )
    on_misfit: Literal["error", "warn"] = Field(
        "error",
        description="what to do when most keypoints, or a camera's masks, are elsewhere than the tracked template: "
        "stop and say which, or only say so",
    )
    context_frames: int = Field(8, ge=0, description="frames on either side of a chunk, solved along")
    use_test_cameras: bool = Field(False, description="whether held-out cameras' keypoints and masks help tracking")
