"""Settings of the stage `synthesize_capture`."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from pipeline.config.settings import Settings

Material = Literal["opaque", "translucent"]


class SynthesizeCapture(Settings):
    """A procedural subject in a procedural light stage; the defaults make `subjectA`."""

    figure: Literal["body", "head"] = Field("body", description="what is captured: a skinned body or an unrigged head")
    material: Material = Field(
        "opaque", description="opaque: painted, under a coat; translucent: a medium that scatters light, under a coat"
    )
    mean_free_path_m: float = Field(
        0.03, gt=0, description="distance that light goes in a translucent material until it is scattered [m]"
    )
    scattering_albedo: tuple[float, ...] = Field(
        (0.97, 0.92, 0.85),
        min_length=3,
        max_length=3,
        description="share of the light that goes on at each scattering in a translucent material: red, green, blue",
    )
    painted_share: float = Field(
        0.0,
        ge=0,
        le=1,
        description="share of the light below the coat that a translucent material's painted surface takes before any "
        "enters; 0: it shows no paint",
    )
    hair_strands: int = Field(
        0, ge=0, description="strands of hair on a head, below its template's surface; 0: hair is painted on it"
    )
    framed_height_m: float = Field(
        2.05, gt=0.1, description="height of the scene that fills the image at the stage's centre: subject and room [m]"
    )
    cameras: int = Field(8, ge=2, description="cameras on a ring around the subject")
    lights: int = Field(24, ge=3, description="lights on the dome")
    frames: int = Field(24, ge=2, description="frames of both segments together")
    frames_b: int = Field(8, ge=1, description="frames of segment b, the last ones; it is the test segment")
    fps: float = Field(12.0, gt=0, description="frames per second")
    width: int = Field(120, ge=16, description="image width [pixels]")
    height: int = Field(160, ge=16, description="image height [pixels]")
    downsample_from_sensor: int = Field(4, ge=1, description="sensor pixels per image pixel along one axis")
    test_cameras: int = Field(2, ge=0, description="cameras held out for testing")
    test_frames: int = Field(2, ge=0, description="partially lit frames of segment a held out for testing")
    test_patterns: int = Field(
        0, ge=0, description="further partially lit frames of segment a, whose light patterns are held out for testing"
    )

    fully_lit_every: int = Field(3, ge=2, description="every n-th frame has all lights on")
    partial_lights_min: int = Field(4, ge=1, description="fewest lights on in a partially lit frame")
    partial_lights_max: int = Field(8, ge=1, description="most lights on in a partially lit frame")
    total_intensity: float = Field(
        38.0, gt=0, description="sum of the radiant intensities of the lights that are on, usually [image value * m^2]"
    )
    camera_distance_m: float = Field(2.5, gt=1, description="distance of the cameras from the stage's centre [m]")
    light_distance_m: float = Field(2.2, gt=1, description="radius of the light dome [m]")
    survey_error_m: float = Field(0.015, ge=0, description="standard deviation of a surveyed light coordinate [m]")
    distortion: float = Field(1.0, ge=0, description="strength of lens distortion, 1 = a few sensor pixels")
    color_spread: float = Field(0.035, ge=0, description="standard deviation of the cameras' colour response entries")

    uvs: bool = Field(True, description="the template has texture coordinates")
    vertex_spacing_m: float = Field(0.032, gt=0.002, lt=0.08, description="edge length of the figure's mesh [m]")
    texture_size: int = Field(512, ge=64, description="size of the albedo texture that is rendered [texels]")
    gloss_alpha: float = Field(0.25, gt=0.02, le=1, description="GGX width of the figure's gloss")
    cornea_alpha: float = Field(0.05, ge=0.01, le=1, description="GGX width of a head's corneas: nearly a mirror")
    scale_to_m: float = Field(1.0, gt=0, description="metres per unit of the template file [m]")

    spp: int = Field(64, ge=1, description="light paths per image pixel of partially lit frames")
    spp_fully_lit: int = Field(
        256, ge=1, description="light paths per image pixel of fully lit frames, whose paths choose among more lights"
    )
    light_choice: Literal["drawn", "all"] = Field(
        "drawn",
        description="drawn: every path goes to one of the lights that are on; all: the paths are shared out among "
        "them, each gets one at least, which leaves less noise",
    )
    spp_eyes: int = Field(
        512,
        ge=1,
        description="light paths per image pixel around a head's eyes in partially lit frames, as glints are smaller "
        "than pixels; in fully lit frames more, as elsewhere",
    )
    supersampling: int = Field(2, ge=1, le=8, description="rendered pixels per image pixel along one axis")
    max_depth: int = Field(
        4,
        ge=2,
        description="path edges from camera to light; 2 is direct light only, a translucent material takes hundreds",
    )
    renderer: Literal["auto", "scalar", "llvm"] = Field(
        "auto",
        description="scalar: one path at a time; llvm: packets of paths in compiled kernels, several times as fast, if "
        "there is an LLVM library of version 16 or newer; auto: llvm where there is, a trial image is right and there "
        "are enough paths, else scalar. Images agree within noise. Translucent material and hair always take scalar",
    )
    shot_gain: float = Field(1e-4, ge=0, description="noise variance per unit of signal [image value]")
    read_noise: float = Field(0.001, ge=0, description="noise deviation in the dark [image value]")
    saturation: float = Field(1.0, gt=0, description="largest value of an image above its black level [image value]")
    black_level: float = Field(0.0, ge=0, description="value of a pixel that receives no light [image value]")

    keypoint_noise_px: float = Field(0.35, ge=0, description="deviation of detected keypoints [image pixels]")
    keypoint_outliers: float = Field(0.03, ge=0, le=1, description="share of keypoints detected in a wrong place")

    board_squares_x: int = Field(7, ge=3, description="squares of the ChArUco board along its width")
    board_squares_y: int = Field(5, ge=3, description="squares of the ChArUco board along its height")
    board_square_m: float = Field(0.12, gt=0, description="side of a board square [m]")
    board_marker_m: float = Field(0.09, gt=0, description="side of a board marker [m]")
    board_poses: int = Field(40, ge=3, description="poses of the board; a camera sees about a quarter of them")
    ball_positions: int = Field(3, ge=1, description="positions of the mirror ball")
    ball_cameras: int = Field(3, ge=1, description="cameras that photograph the mirror ball")
    ball_radius_m: float = Field(0.18, gt=0, description="radius of the mirror ball [m]")
    light_radius_m: float = Field(0.05, gt=0, description="radius of a light as seen in the mirror ball [m]")
