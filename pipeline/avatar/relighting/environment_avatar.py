"""An avatar under an environment map without its pixels: harmonics for the transfer, one look-up for the lobe.

The light stays in the map's own frame: a map that is turned turns what asks for light the other way instead, so that
neither harmonics nor prefiltered panoramas are made again.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.avatar.model import SMALLEST_ALPHA, Avatar
from pipeline.avatar.pose import FrameInputs
from pipeline.avatar.shading import grazing_gain, mean_grazing_gain, points_of_pixels, shade_diffuse
from pipeline.lighting.environment_lobes import LobeLadder
from pipeline.lighting.environment_sh import gather_environment
from pipeline.lighting.lobes import mirror_direction, unit
from pipeline.rendering.splat_conventions import Splatted


@dataclass(frozen=True)
class PreparedSky:
    """A map's light in the forms that shading asks for.

    Attributes:
        harmonics: L_lm of `pipeline.lighting.environment_sh`, linear RGB.
        ladder: prefiltered panoramas; None for an avatar without specular lobe.
        world_from_map: rotation of the map.
    """

    harmonics: Float[Tensor, "81 3"]
    ladder: LobeLadder | None
    world_from_map: Float[Tensor, "3 3"]


@dataclass
class SkyInputs(FrameInputs):
    """A frame's pose and irradiance maps, without lights of its own, and the sky it is under."""

    sky: PreparedSky


class EnvironmentAvatar(Avatar):
    """The same parameters, under the sky that comes with a frame's inputs; `view` as ever."""

    def prepare(self, inputs: SkyInputs) -> dict:
        """As the avatar's; the frame keeps the sky for its views."""
        return {**super().prepare(inputs), "sky": inputs.sky}

    def shade_direct(self, frame: dict, axes: Tensor, inputs: SkyInputs) -> Float[Tensor, "texels 3"]:
        """Diffuse light of the sky (RFGCA 7-9)."""
        harmonics = inputs.sky.harmonics[: self.spec.degrees**2]
        light = gather_environment(inputs.sky.world_from_map.T @ axes, harmonics)
        return shade_diffuse(self.albedo, frame["transfer_color"], frame.get("transfer_mono"), light)

    def reflect(
        self, frame: dict, center: Tensor, points: Tensor, normals: Tensor, roughness: Tensor, visibility: Tensor
    ) -> Float[Tensor, "pixels 3"]:
        """As the avatar's, of the sky: a pixel on an eye's rim mirrors much of it."""
        to_camera = unit(center - points)
        gained = visibility * mean_grazing_gain(normals, to_camera, roughness)
        return gained[:, None] * _mirrored_sky(frame, normals, to_camera, roughness)

    def shade_pixels(
        self, pixels: dict, picture: Splatted, frame: dict, R: Tensor, center: Tensor, K: Tensor
    ) -> Tensor:
        """As the avatar's, the lobe looked up where the avatar sums over lights (RFGCA 11-12)."""
        if "normal" in pixels:
            row, column = torch.nonzero(picture.alpha > SMALLEST_ALPHA, as_tuple=True)
            normal, roughness, visibility = (
                pixels[name][row, column] for name in ("normal", "roughness", "visibility")
            )
            # All of a sky is as far away as its horizon: only the direction of a pixel's ray matters, not its depth.
            points = points_of_pixels(row, column, R.new_ones(len(row)), R, center, K)
            width = roughness[:, 0] / picture.alpha[row, column]
            normal, to_camera = unit(normal), unit(center - points)
            gained = visibility * grazing_gain(normal, to_camera)[:, None]
            specular = gained * _mirrored_sky(frame, normal, to_camera, width)
            pixels = {name: layer for name, layer in pixels.items() if name != "normal"}
            pixels["color"] = pixels["color"].index_put((row, column), specular, accumulate=True)
        return super().shade_pixels(pixels, picture, frame, R, center, K)


def _mirrored_sky(
    frame: dict, normals: Float[Tensor, "n 3"], to_camera: Float[Tensor, "n 3"], width: Float[Tensor, " n"]
) -> Float[Tensor, "n 3"]:
    mirrored = mirror_direction(normals, to_camera) @ frame["sky"].world_from_map
    return frame["sky"].ladder.look_up(mirrored, width)
