"""Hard cases of light and of pixels, as curves: highlights, lights on a surface, thin Gaussians, black.

Ours are the functions of `pipeline`, the naive ones those that `tests/hard_cases` holds them against; the truth is
float64, in a form that keeps its digits.
"""

from __future__ import annotations

import math

import numpy as np
import torch

from docs.generate.hard_case_curves import Curves
from pipeline.avatar.appearance.penalties import ROUGHNESS_BOUNDS
from pipeline.base.color import BREAK_LINEAR, SLOPE, srgb_from_linear
from pipeline.lighting.distant import arriving_light
from pipeline.lighting.lobes import LOBE_CONSTANT, angular_gaussian
from pipeline.lighting.microfacet import gather_reflections, gather_reflections_reference
from pipeline.lighting.point_lights import PointLights
from pipeline.lighting.zonal import SMALLEST_DISTANCE2_M2
from pipeline.rendering.splat import splat
from pipeline.rendering.splat_conventions import MIN_ALPHA
from pipeline.rendering.splat_types import CameraView, Gaussians, SplatOptions
from tests.support.naive.shading import naive_distribution, naive_falloff, naive_lobe_slope, naive_srgb_slope
from tests.support.naive.surfaces import naive_alphas


def narrow_highlight() -> Curves:
    """GGX of width 0.001: radiance over that in the middle, where normal and half vector agree."""
    alpha, camera = 2.0**-10, math.radians(20)
    half = np.linspace(0, 2.5e-3, 151)
    to_camera = torch.tensor([[math.sin(camera), 0, math.cos(camera)]], dtype=torch.float64)
    beside = camera + 2 * half
    light = torch.tensor(np.stack([-np.sin(beside), 0 * half, np.cos(beside)], 1))
    point, up = torch.zeros(1, 3, dtype=torch.float64), torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64)
    width, one = torch.tensor([alpha], dtype=torch.float64), torch.ones(1, 1, dtype=torch.float64)
    truth, ours = [], []
    for place in light[:, None]:
        truth.append(gather_reflections_reference(point, up, to_camera, width, place, one).item())
        rounded = [tensor.float() for tensor in (point, up, to_camera, width)]
        ours.append(gather_reflections(*rounded, PointLights(place.float(), one.float())).item())
    coarse = naive_distribution(to_camera.float(), light.float(), alpha).double()
    naive = np.array(truth) * (coarse / naive_distribution(to_camera, light, alpha)).numpy()
    values = (np.array(row) / truth[0] for row in (ours, naive, truth))
    labels = "GGX of width 0.001", "half vector from normal, mrad", "radiance over its peak"
    return Curves(*labels, 1e3 * half, *values, shown=(-0.05, 1.1))


def slope_of_a_glint() -> Curves:
    """The smallest roughness: the papers' lobe, its slope beside the mirror direction over the steepest."""
    sigma = ROUGHNESS_BOUNDS[0]
    angle = np.linspace(0, 1e-3, 101)
    steepest = LOBE_CONSTANT / sigma**2 * math.exp(-0.5)
    ours, naive = [], []
    for value in angle:
        p, q = (math.cos(value), math.sin(value), 0.0), (1.0, 0.0, 0.0)
        at = torch.tensor(p, requires_grad=True)
        (slope,) = torch.autograd.grad(angular_gaussian(at, torch.tensor(q), torch.tensor(sigma)), at)
        along = torch.tensor((-math.sin(value), math.cos(value), 0.0))
        ours.append((slope @ along).item())
        naive.append((naive_lobe_slope(p, q, sigma) @ along).item())
    truth = -LOBE_CONSTANT / sigma**3 * angle * np.exp(-0.5 * (angle / sigma) ** 2)
    values = (-np.array(row) / steepest for row in (ours, naive, truth))
    labels = "Slope of a glint of roughness 0.01", "light from mirror direction, mrad", "slope over the steepest"
    return Curves(*labels, 1e3 * angle, *values, shown=(-0.01, 0.18))


def light_on_the_surface() -> Curves:
    """1 / d^2, nearer than a tenth of a millimetre as at a tenth of a millimetre."""
    distance = np.geomspace(1e-8, 1e-1, 141)
    apart = torch.tensor(distance, dtype=torch.float32)
    place, power = torch.zeros(1, 3), torch.ones(1, 1)
    ours = [arriving_light(place, PointLights(torch.tensor([[0, 0, float(d)]]), power)).item() for d in apart]
    truth = 1 / np.maximum(distance**2, float(SMALLEST_DISTANCE2_M2))
    values = np.array(ours), naive_falloff(apart).double().numpy(), truth
    return Curves(
        "A light on the surface", "distance, m", "arriving light, 1/m²", distance, *values, (10, 1e13), ("log", "log")
    )


def needle() -> Curves:
    """A Gaussian without width, 2 pixels aside from a pixel: alpha by its length, which hardly matters."""
    size, focal, depth, opacity, degrees, dilation = 24, 60.0, 2.0, 0.7, 30.0, 0.1
    turn = math.radians(degrees) / 2
    K = torch.tensor([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]])
    view = CameraView(torch.eye(3), torch.zeros(3), K, size, size)
    length, (row, column) = np.geomspace(3, 3e5, 101), (17, 22)
    ours, naive, truth = [], [], []
    for long_px in length:
        scales = torch.tensor([[long_px * depth / focal, 0.0, 0.0]])
        quaternion = torch.tensor([[math.cos(turn), 0.0, 0.0, math.sin(turn)]])
        gaussian = Gaussians(torch.tensor([[0.0, 0.0, depth]]), quaternion, scales, torch.tensor([opacity]))
        ours.append(splat(gaussian, torch.ones(1, 1), view, SplatOptions(dilation_px2=dilation)).alpha[row, column])
        given = size, opacity, (long_px, 0.0), degrees, dilation
        naive.append(naive_alphas(*given)[row, column])
        truth.append(across_and_along(row + 0.5 - size / 2, column + 0.5 - size / 2, long_px, degrees, dilation))
    exact = opacity * np.array(truth)
    values = np.array(ours, float), np.array(naive, float), np.where(exact < MIN_ALPHA, 0.0, exact)
    return Curves("A Gaussian thinner than a pixel", "its length, pixels", "alpha of a pixel", length, *values,
                  (-0.03, 0.75), ("log", "linear"))  # fmt: skip


def across_and_along(y: float, x: float, long_px: float, degrees: float, dilation: float) -> float:
    """Exponential of a needle at a pixel in the needle's own axes, where nothing cancels."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    along, across = c * x + s * y, c * y - s * x
    return math.exp(-0.5 * (along**2 / (long_px**2 + dilation) + across**2 / dilation))


def black_in_srgb() -> Curves:
    """Slope of the transfer function at black, and below."""
    linear = np.linspace(-2e-3, 6e-3, 161)
    at = torch.tensor(linear, dtype=torch.float32, requires_grad=True)
    (ours,) = torch.autograd.grad(srgb_from_linear(at).sum(), at)
    power = 1.055 / 2.4 * np.maximum(linear, 1e-9) ** (1 / 2.4 - 1)
    truth = np.where(linear <= BREAK_LINEAR, SLOPE, power)
    naive = np.array([naive_srgb_slope(float(value)) for value in linear])
    return Curves("Slope of sRGB at black", "linear value, thousandths of white", "slope", 1e3 * linear,
                  ours.double().numpy(), naive, truth, (0, 40))  # fmt: skip
