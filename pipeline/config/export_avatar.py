"""Settings of export_avatar."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from pipeline.config.settings import Settings


class ExportAvatar(Settings):
    """Formats and frames of an avatar as files that other programs open."""

    formats: tuple[Literal["ply", "spz", "sog", "glb", "mesh", "stage", "usd"], ...] = Field(
        ("ply", "spz", "sog", "glb", "mesh", "stage", "usd"),
        min_length=1,
        description="what is written. Gaussians of a frame: ply (3DGS), spz, sog, glb (KHR_gaussian_splatting); "
        "mesh: the posed surface with textures, glTF; stage, usd: cameras and lights, glTF and USD",
    )
    spz_version: Literal[3, 4] = Field(
        3, description="of .spz; 3 is opened by readers of both, 4 by newer ones, and is a little smaller"
    )
    splat_frames: int = Field(
        1, ge=1, description="frames whose Gaussians are written, spread over all, the first among them [frames]"
    )
    animation: Literal["auto", "targets"] = Field(
        "auto",
        description="what moves the mesh. auto: a skin where the template has joints, and morph targets for what they "
        "cannot do; targets: a morph target for each frame",
    )
    animation_frames: int = Field(60, ge=1, description="frames of the mesh's animation, spread over all [frames]")
    exposure: float = Field(1.0, gt=0, description="factor on the radiance of Gaussians before it is encoded as sRGB")
