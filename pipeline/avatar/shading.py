"""Shading of texels and pixels under point lights: learned transfer with a deferred lobe, and microfacets."""

from __future__ import annotations

import math

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor

from pipeline.lighting.environment_sh import COEFFICIENTS, spherical_harmonics
from pipeline.lighting.lobes import Lobe, angle_between, angular_gaussian, mirror_direction, unit
from pipeline.lighting.microfacet import DIELECTRIC_F0, arriving_vectors, gather_reflections
from pipeline.lighting.specular_lobes import gather_glints
from pipeline.lighting.zonal import DEGREES, SMALLEST_DISTANCE2_M2, clamped_cosine_coefficients

COLOR_DEGREES = 4
"""Degrees 0..3 of the transfer are coloured, 4..8 monochrome (RGCA section 3.3, RFGCA 9)."""


UNTURNED_SCALE = 3.43
"""Unturned coefficients are stored this much larger. The harmonics of a light's direction have absolute values that sum
to 18.0 on average, those that three zonal lobes multiply, to 5.25: with the ratio taken out, a step of Adam moves both
kinds of transfer as far, and both are held to their start about as strongly."""


def start_transfer(degrees: int = DEGREES) -> tuple[Float[Tensor, "3 color 3"], Float[Tensor, "3 mono"]]:
    """Zonal coefficients of a Lambertian texel, coloured and monochrome: tangent and bitangent lobes are empty.

    `degrees`: 0, 1 and so on to one less than this; above `COLOR_DEGREES` they are monochrome.
    """
    transfer = torch.zeros(3, degrees)
    transfer[2] = torch.as_tensor(clamped_cosine_coefficients()[:degrees])
    return transfer[:, :COLOR_DEGREES, None].repeat(1, 1, 3), transfer[:, COLOR_DEGREES:].clone()


def start_harmonics(
    normals: Float[Tensor, "texels 3"],
    degrees: int = DEGREES,
) -> tuple[Float[Tensor, "texels color 3"], Float[Tensor, "texels mono"]]:
    """SH coefficients of a Lambertian texel, z_l Y_lm(n) in the frame of its normal n, times `UNTURNED_SCALE`."""
    lobe = torch.as_tensor(clamped_cosine_coefficients()[:degrees], dtype=torch.float32)
    orders = torch.arange(1, 2 * degrees, 2)
    transfer = UNTURNED_SCALE * spherical_harmonics(normals, degrees) * lobe.repeat_interleave(orders)
    return transfer[:, : COLOR_DEGREES**2, None].repeat(1, 1, 3), transfer[:, COLOR_DEGREES**2 :].clone()


def shade_diffuse(
    albedo: Float[Tensor, "texels 3"],
    transfer_color: Float[Tensor, "texels 3 color 3"],
    transfer_mono: Float[Tensor, "texels 3 mono"] | None,
    light: Float[Tensor, "texels 3 degrees channels"],
) -> Float[Tensor, "texels 3"]:
    """c_d = albedo * sum over axes a and degrees l of z_al times the light gathered there (RFGCA 7-9)."""
    color = (transfer_color * light[:, :, :COLOR_DEGREES]).sum((1, 2))
    if transfer_mono is None:
        return albedo * color
    mono = (transfer_mono[..., None] * light[:, :, COLOR_DEGREES:]).sum((1, 2))
    return albedo * (color + mono)


def shade_specular(
    points: Float[Tensor, "pixels 3"],
    normals: Float[Tensor, "pixels 3"],
    roughness: Float[Tensor, "pixels"],
    visibility: Float[Tensor, "pixels"],
    camera_center: Float[Tensor, "3"],
    light_positions: Float[Tensor, "lights 3"],
    intensities: Float[Tensor, "lights channels"],
    lobe: Lobe = angular_gaussian,
) -> Float[Tensor, "pixels channels"]:
    """c_s = v F(n . w_o) sum over lights of (I / d^2) G(w_i; q, sigma): RFGCA 11-12 with point lights as Diracs.

    Points in metres, normals of any length (they are blended averages), linear radiance out. F: see `grazing_gain`.
    """
    normals, to_camera = unit(normals), unit(camera_center - points)
    mirrored = mirror_direction(normals, to_camera)
    glints = gather_glints(points, mirrored, roughness, light_positions, intensities, lobe)
    return (visibility * grazing_gain(normals, to_camera))[:, None] * glints


def shade_halfway(
    points: Float[Tensor, "pixels 3"],
    normals: Float[Tensor, "pixels 3"],
    roughness: Float[Tensor, "pixels"],
    visibility: Float[Tensor, "pixels"],
    camera_center: Float[Tensor, "3"],
    light_positions: Float[Tensor, "lights 3"],
    intensities: Float[Tensor, "lights channels"],
) -> Float[Tensor, "pixels channels"]:
    """As `shade_specular`, with the lobe about the half vector of each light, see `gather_reflections`: F is taken
    there, and roughness hides part of a light that grazes the surface, and all of one below it."""
    seen = every_light(len(intensities), len(points))
    normals, to_camera, width = unit(normals), unit(camera_center - points), roughness / math.sqrt(2)
    lights = (light_positions, intensities, seen)
    return visibility[:, None] * gather_reflections(points, normals, to_camera, width, *lights, gaussian=True)


def shade_near_mirrors(
    points: Float[Tensor, "pixels 3"],
    normals: Float[Tensor, "pixels 3"],
    roughness: Float[Tensor, "pixels"],
    visibility: Float[Tensor, "pixels"],
    camera_center: Float[Tensor, "3"],
    light_positions: Float[Tensor, "lights 3"],
    intensities: Float[Tensor, "lights channels"],
    lobe: Lobe = angular_gaussian,
) -> Float[Tensor, "pixels channels"]:
    """As `shade_specular`, of points near each other whose normals change much within a pixel: eyes.

    F is taken at each light's own half vector, seen from the middle of the points. At the normal of a pixel that covers
    a sphere's rim it would be that of a grazing mirror for lights that the pixel mirrors elsewhere.
    """
    if not len(points):
        return points.new_zeros(0, intensities.shape[1])
    middle = points.mean(0)
    to_camera, to_light = unit(camera_center - middle), unit(light_positions - middle)
    gain = grazing_gain(unit(to_light + to_camera), to_camera[None])
    mirrored = mirror_direction(unit(normals), unit(camera_center - points))
    glints = gather_glints(points, mirrored, roughness, light_positions, gain[:, None] * intensities, lobe)
    return visibility[:, None] * glints


def grazing_gain(normals: Float[Tensor, "n 3"], to_camera: Float[Tensor, "#n 3"]) -> Float[Tensor, " n"]:
    """How much more a dielectric mirrors towards w_o than straight back: 1 at normal incidence, 25 at grazing.

    v depends on the view in RFGCA 14. This is the part of it that all dielectrics share (Schlick 1994, divided by its
    value at normal incidence); at the lobe's centre the half vector is the normal. Unit vectors.
    """
    cosine = (normals * to_camera).sum(-1).clamp(0, 1)
    return 1 + (1 / DIELECTRIC_F0 - 1) * (1 - cosine) ** 5


def mean_grazing_gain(
    normals: Float[Tensor, "n 3"], to_camera: Float[Tensor, "n 3"], width: Float[Tensor, " n"]
) -> Float[Tensor, " n"]:
    """Mean of `grazing_gain` over half vectors that spread by half of a lobe's width, radians, by Gauss and Hermite's
    three points. Light from beyond the camera's horizon comes back on the other side of it."""
    angle, step = angle_between(normals, to_camera), math.sqrt(3) / 2 * width
    cosines = torch.stack([(angle + offset * step).cos().abs() for offset in (-1, 0, 1)], -1)
    gains = 1 + (1 / DIELECTRIC_F0 - 1) * (1 - cosines) ** 5
    return gains @ gains.new_tensor([1 / 6, 2 / 3, 1 / 6])


def shade_harmonics(
    albedo: Float[Tensor, "texels 3"],
    transfer_color: Float[Tensor, "texels color 3"],
    transfer_mono: Float[Tensor, "texels mono"] | None,
    light: Float[Tensor, "#texels coefficients channels"],
) -> Float[Tensor, "texels 3"]:
    """c_d with SH coefficients, at degree 8 113 per texel instead of 51 zonal ones (RGCA 5), in the frame of `light`;
    these are stored times `UNTURNED_SCALE`. Without monochrome ones, degrees above 3 of the light are not seen."""
    color = (transfer_color * light[:, : COLOR_DEGREES**2]).sum(1)
    if transfer_mono is None:
        return albedo / UNTURNED_SCALE * color
    mono = (transfer_mono[..., None] * light[:, COLOR_DEGREES**2 :]).sum(1)
    return albedo / UNTURNED_SCALE * (color + mono)


def shade_viewed(
    harmonics: Float[Tensor, "texels 81"], light: Float[Tensor, "#texels 81 channels"]
) -> Float[Tensor, "texels channels"]:
    """What is specular, by harmonics that depend on the view (EyeNeRF), in the frame of `light`; may be negative, as a
    band-limited highlight is beside its peak."""
    return (harmonics[..., None] * light).sum(1)


@torch.no_grad()
def gather_harmonics(
    points: Float[Tensor, "texels 3"],
    body: Float[Tensor, "3 3"],
    light_positions: Float[Tensor, "lights 3"],
    intensities: Float[Tensor, "lights channels"],
) -> Float[Tensor, "texels 81 channels"]:
    """sum_j I_j / d_j^2 Y_lm(w_j) at every texel, with the directions w_j turned by `body` (body from world)."""
    out = points.new_zeros(len(points), COEFFICIENTS, intensities.shape[1])
    for position, intensity in zip(light_positions, intensities, strict=True):
        offset = position - points
        distance2 = offset.square().sum(-1, keepdim=True).clamp_min(float(SMALLEST_DISTANCE2_M2))
        harmonics = spherical_harmonics(unit(offset) @ body.T) / distance2
        out += harmonics[..., None] * intensity
    return out


def points_of_pixels(
    row: Int[Tensor, "pixels"], column: Int[Tensor, "pixels"], depth: Float[Tensor, "pixels"],
    R: Float[Tensor, "3 3"], center: Float[Tensor, "3"], K: Float[Tensor, "3 3"],
) -> Float[Tensor, "pixels 3"]:  # fmt: skip
    """World points, metres, at the given depths along the axis of the camera."""
    x, y = (column + 0.5 - K[0, 2]) / K[0, 0], (row + 0.5 - K[1, 2]) / K[1, 1]
    return depth[:, None] * torch.stack([x, y, torch.ones_like(depth)], -1) @ R + center


def every_light(lights: int, points: int) -> UInt8[np.ndarray, "lights bytes"]:
    """Visibility bits where nothing is hidden."""
    return np.full((lights, (points + 7) // 8), 255, np.uint8)


def shade_matte(
    albedo: Float[Tensor, "texels 3"],
    points: Float[Tensor, "texels 3"],
    normals: Float[Tensor, "texels 3"],
    light_positions: Float[Tensor, "lights 3"],
    intensities: Float[Tensor, "lights channels"],
    seen: UInt8[np.ndarray, "lights bytes"],
) -> Float[Tensor, "texels 3"]:
    """Lambert under the lights that are seen: albedo / pi * sum I / d^2 max(0, n . w)."""
    vectors = arriving_vectors(points, normals, light_positions, intensities, seen)
    return albedo / torch.pi * (vectors * normals[:, None]).sum(-1)


def shade_gloss(
    width: Float[Tensor, "texels"], frame: dict, camera_center: Float[Tensor, "3"]
) -> Float[Tensor, "texels channels"]:
    """Light that a dielectric's surface reflects to the camera, of a prepared frame."""
    points = frame["means"].detach()
    return gather_reflections(
        points, frame["bent_normals"], unit(camera_center - points), width, frame["light_positions"],
        frame["intensities"], frame["seen"],
    )  # fmt: skip


@torch.no_grad()
def arriving_light(
    points: Float[Tensor, "texels 3"],
    light_positions: Float[Tensor, "lights 3"],
    intensities: Float[Tensor, "lights channels"],
) -> Float[Tensor, "texels channels"]:
    """Sum of I / d^2, seen or not."""
    distance2 = torch.cdist(points, light_positions).square().clamp_min(float(SMALLEST_DISTANCE2_M2))
    return (1 / distance2) @ intensities
