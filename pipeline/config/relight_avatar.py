"""Settings of relight_avatar."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from pipeline.config.settings import Settings


class RelightAvatar(Settings):
    """Pictures of an avatar in new light, their cameras, and the files to write.

    Lights and cameras may also come from files.
    """

    first_frame: int = Field(0, ge=0, description="first tracked frame shown [frame number]")
    last_frame: int | None = Field(None, ge=0, description="last tracked frame shown; null: the last [frame number]")
    segment: str = Field("", description="segment of the capture whose frames are shown; empty: all")
    pictures: int | None = Field(
        None,
        ge=1,
        description="pictures over which the frames are spread, repeated if need be; null: one each, or as many as "
        "the codes are for",
    )
    head_motion: Literal["tracked", "first", "rest"] = Field(
        "tracked",
        description="heads: moved as in each frame, held still as in the first frame shown, or as the template stands",
    )
    codes: str = Field(
        "",
        description="heads: .csv table with picture, code_0, code_1, ... of latent codes, in place of the frames' "
        "expressions; linear between its rows. A film's own are in its codes.csv",
    )
    gaze: str = Field(
        "",
        description=".csv table with picture, eye, x, y, z: unit directions in the head's frame that explicit eyes "
        "look in; on the great circle between its rows; empty: as captured",
    )
    gaze_direction: tuple[float, ...] = Field(
        (), description="the same for all eyes and pictures: three numbers; none: as captured"
    )
    height: int = Field(832, ge=16, le=8192, description="height of the pictures [pixels]")
    width: int = Field(640, ge=16, le=8192, description="width, unless calibrated cameras give the shape [pixels]")
    fps: float = Field(24.0, gt=0, le=240, description="pictures per second of the film [1/s]")

    camera_names: tuple[str, ...] = Field(
        (), description="calibrated cameras that the path leads through, in this order; none: an orbit"
    )
    orbit_center: tuple[float, ...] = Field(
        (), description="point the orbit looks at, three numbers; none: the middle of the poses shown [m]"
    )
    orbit_radius: float = Field(2.8, gt=0, description="horizontal distance of the orbit from its centre [m]")
    orbit_rise: float = Field(0.2, description="height of the orbit above its centre [m]")
    orbit_turns: float = Field(1.0, description="rounds of the orbit, 0: the camera stands still")
    fov_y_degrees: float = Field(36.0, gt=0, lt=180, description="angle from top to bottom of the orbit's pictures")

    environment_turns: float = Field(
        0.0, description="rounds that an environment map makes about the vertical, from its first picture to its last"
    )
    environment_light: Literal["auto", "lobes", "pixels"] = Field(
        "auto",
        description="lobes: harmonics and prefiltered panoramas of the whole map; pixels: the reduced map's pixels as "
        "distant lights; auto: lobes where the avatar allows it",
    )
    environment_height: int = Field(
        16, ge=2, le=256, description="height to which a map is reduced as distant lights and for shadow rays [pixels]"
    )
    prefiltered_height: int | None = Field(
        None, ge=2, description="height to which a map is reduced before its lobes; null: it stays as it is [pixels]"
    )
    light_turns: float = Field(
        0.0,
        description="rounds that a list of lamps makes about the vertical through the middle of the poses shown, "
        "beside its own motion",
    )
    shadow_samples: str = Field(
        "full", pattern=r"^(full|[1-9][0-9]{0,3})$", description="lights drawn per texel for shadows, or full [rays]"
    )

    exposure: float = Field(1.0, gt=0, description="factor on radiance in .png, film and .ply; .exr stays as it is")
    background: Literal["black", "environment"] = Field(
        "environment", description="what .png and film show behind the subject, if there is an environment map"
    )
    stills: Literal["none", "png", "exr", "both"] = Field(
        "png", description="every picture as a file; .exr has linear light over black, and A"
    )
    exr_layers: bool = Field(
        False, description="parts of the picture in .exr, too: albedo, normal, diffuse, indirect, specular, depth"
    )
    beside_captured: bool = Field(
        False,
        description="on the left of film and .png, the captured picture of each frame; camera_names names its camera",
    )
    splats: Literal["none", "first", "all"] = Field(
        "first", description="pictures of which the Gaussians are written as .ply, without their specular part"
    )
