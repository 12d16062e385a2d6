"""Specular lobes about the mirror direction and about half vectors (RFGCA 11-13, RGCA 6)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.config.trained_model import Fresnel
from pipeline.lighting.lobes import Lobe, angle_between, angular_gaussian, mirror_direction, unit
from pipeline.lighting.microfacet import DIELECTRIC_F0, gather_reflections
from pipeline.lighting.point_lights import PointLights
from pipeline.lighting.specular_lobes import gather_specular


@dataclass(frozen=True)
class GlossySamples:
    """Points that a specular lobe is evaluated at: texels, or pixels.

    Attributes:
        points: metres.
        normals: of any length; they may be blended averages.
        roughness: widths of the lobe, radians.
        visibility: v_k, the lobe's factor.
    """

    points: Float[Tensor, "n 3"]
    normals: Float[Tensor, "n 3"]
    roughness: Float[Tensor, " n"]
    visibility: Float[Tensor, " n"]

    def __len__(self) -> int:
        return len(self.points)


def shade_specular(
    samples: GlossySamples,
    camera_center: Float[Tensor, "3"],
    lights: PointLights,
    lobe: Lobe = angular_gaussian,
    fresnel: Fresnel = "schlick",
) -> Float[Tensor, "n channels"]:
    """Evaluate a lobe about the mirror direction.

    RFGCA 11-12 with point lights as Diracs; linear radiance.

    c_s = v F(n . w_o) sum over lights of (I / d^2) G(w_i; q, sigma); F: see `grazing_gain`, or 1.
    """
    normals, to_camera = unit(samples.normals), unit(camera_center - samples.points)
    mirrored = mirror_direction(normals, to_camera)
    gathered = gather_specular(samples.points, mirrored, samples.roughness, lights, lobe)
    if fresnel == "none":
        return samples.visibility[:, None] * gathered
    return (samples.visibility * grazing_gain(normals, to_camera))[:, None] * gathered


def shade_halfway(
    samples: GlossySamples, camera_center: Float[Tensor, "3"], lights: PointLights
) -> Float[Tensor, "n channels"]:
    """Evaluate a lobe about the half vector of each light, see `gather_reflections`.

    F is taken there, and roughness hides part of a light that grazes the surface, and all of one below it.
    """
    everywhere = PointLights(lights.positions_m, lights.intensities)
    normals, to_camera = unit(samples.normals), unit(camera_center - samples.points)
    width = samples.roughness / math.sqrt(2)
    gathered = gather_reflections(samples.points, normals, to_camera, width, everywhere, gaussian=True)
    return samples.visibility[:, None] * gathered


def shade_near_mirrors(
    samples: GlossySamples,
    camera_center: Float[Tensor, "3"],
    lights: PointLights,
    lobe: Lobe = angular_gaussian,
    fresnel: Fresnel = "schlick",
) -> Float[Tensor, "n channels"]:
    """Evaluate a lobe at points near each other whose normals change much within a pixel: eyes.

    As `shade_specular`, but F, if any, is taken at each light's own half vector, seen from the middle of the points.
    At the normal of a pixel that covers a sphere's rim it would be that of a grazing mirror for lights that the pixel
    mirrors elsewhere.
    """
    points, intensities = samples.points, lights.intensities
    if not len(points):
        return points.new_zeros(0, intensities.shape[1])
    if fresnel == "none":
        return shade_specular(samples, camera_center, lights, lobe, fresnel)
    middle = points.mean(0)
    to_camera, to_light = unit(camera_center - middle), unit(lights.positions_m - middle)
    gain = grazing_gain(unit(to_light + to_camera), to_camera[None])
    mirrored = mirror_direction(unit(samples.normals), unit(camera_center - points))
    gained = PointLights(lights.positions_m, gain[:, None] * intensities)
    return samples.visibility[:, None] * gather_specular(points, mirrored, samples.roughness, gained, lobe)


def grazing_gain(normals: Float[Tensor, "n 3"], to_camera: Float[Tensor, "#n 3"]) -> Float[Tensor, " n"]:
    """Gain of a dielectric's mirroring towards w_o over straight back.

    1 at normal incidence, 25 at grazing.

    v depends on the view in RFGCA 14. This is the part of it that all dielectrics share (Schlick 1994, divided by its
    value at normal incidence); at the lobe's centre the half vector is the normal. Unit vectors.
    """
    cosine = (normals * to_camera).sum(-1).clamp(0, 1)
    return 1 + (1 / DIELECTRIC_F0 - 1) * (1 - cosine) ** 5


def mean_grazing_gain(
    normals: Float[Tensor, "n 3"], to_camera: Float[Tensor, "n 3"], width: Float[Tensor, " n"]
) -> Float[Tensor, " n"]:
    """Mean of `grazing_gain` over half vectors that spread by half of a lobe's width, radians.

    By Gauss and Hermite's three points. Light from beyond the camera's horizon comes back on the other side of it."""
    angle, step = angle_between(normals, to_camera), math.sqrt(3) / 2 * width
    cosines = torch.stack([(angle + offset * step).cos().abs() for offset in (-1, 0, 1)], -1)
    gains = 1 + (1 / DIELECTRIC_F0 - 1) * (1 - cosines) ** 5
    return gains @ gains.new_tensor([1 / 6, 2 / 3, 1 / 6])
