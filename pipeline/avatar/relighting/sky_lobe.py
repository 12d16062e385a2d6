"""Specular lobe under an environment map: a look-up per pixel (RFGCA 11-12) or Gaussian."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor

from pipeline.avatar.appearance.glossy import GlossySamples, grazing_gain, mean_grazing_gain
from pipeline.avatar.appearance.layers import Layers
from pipeline.avatar.appearance.lobes import SMALLEST_ALPHA, SpecularLobe
from pipeline.avatar.frames.light_fields import SkyField
from pipeline.avatar.frames.prepared import PreparedFrame
from pipeline.avatar.geometry.pixel_depth import points_of_pixels
from pipeline.avatar.model import Avatar
from pipeline.lighting.lobes import mirror_direction, unit
from pipeline.rendering.splat_conventions import Splatted
from pipeline.rendering.splat_types import CameraView


class SkyLobe(SpecularLobe):
    """The parameters of another lobe, under the sky that comes with a frame's inputs."""

    def __init__(self, lobe: SpecularLobe) -> None:
        self.store, self.deferred, self.depth = lobe.store, lobe.deferred, lobe.depth
        self.screen_maps, self.fresnel = lobe.screen_maps, lobe.fresnel

    def shade(self, samples: GlossySamples, frame: PreparedFrame, center: Tensor) -> Float[Tensor, "n 3"]:
        """Look the sky up in mirror directions."""
        normals, to_camera = unit(samples.normals), unit(center - samples.points)
        gained = samples.visibility
        if self.fresnel == "schlick":
            gained = gained * grazing_gain(normals, to_camera)
        return gained[:, None] * _mirrored_sky(frame, normals, to_camera, samples.roughness)

    def shade_pixels(
        self, images: Layers, picture: Splatted, frame: PreparedFrame, camera: CameraView
    ) -> tuple[Int[Tensor, " n"], Int[Tensor, " n"], Float[Tensor, "n 3"]]:
        """Row and column of covered pixels, and what they mirror of the sky."""
        row, column = torch.nonzero(picture.alpha > SMALLEST_ALPHA, as_tuple=True)
        normal, roughness, visibility = (
            layer[row, column] for layer in (images.normal, images.roughness, images.visibility)
        )
        # All of a sky is as far away as its horizon: only the direction of a pixel's ray matters, not its depth.
        points = points_of_pixels(row, column, camera.R.new_ones(len(row)), camera)
        width = self.of_pixels(roughness[:, 0], picture.alpha[row, column])
        pixels = GlossySamples(points, normal, width, visibility[:, 0])
        return row, column, self.shade(pixels, frame, camera.center)

    def reflect(self, mirrors: GlossySamples, frame: PreparedFrame, center: Tensor) -> Float[Tensor, "n 3"]:
        """Of the sky: a pixel on an eye's rim mirrors much of it."""
        to_camera = unit(center - mirrors.points)
        gained = mirrors.visibility
        if self.fresnel == "schlick":
            gained = gained * mean_grazing_gain(mirrors.normals, to_camera, mirrors.roughness)
        return gained[:, None] * _mirrored_sky(frame, mirrors.normals, to_camera, mirrors.roughness)


def works_under_sky(avatar: Avatar) -> bool:
    """Tell an avatar that maps can light by harmonics and panoramas. Nothing of it asks for lights one by one."""
    built = avatar.built
    return all(part.works_under_sky for part in (built.diffuse, built.specular, built.shadow, built.indirect))


def under_sky(avatar: Avatar) -> Avatar:
    """The same parameters, under the sky that comes with a frame's inputs."""
    lobe = avatar.built.specular
    return avatar.variant(field=SkyField(), specular=SkyLobe(lobe) if isinstance(lobe, SpecularLobe) else lobe)


def _mirrored_sky(
    frame: PreparedFrame, normals: Float[Tensor, "n 3"], to_camera: Float[Tensor, "n 3"], width: Float[Tensor, " n"]
) -> Float[Tensor, "n 3"]:
    sky = frame.incident.inputs.sky
    return sky.ladder.look_up(mirror_direction(normals, to_camera) @ sky.world_from_map, width)
