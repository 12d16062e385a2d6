"""Others' lights, head and panoramas: what the pipeline makes of them, beside sums by definition."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float64, Int
from scipy.optimize import least_squares
from scipy.spatial import cKDTree

from pipeline.config.unwrap_atlas import UnwrapAtlas
from pipeline.effects.light_evidence import texel_points
from pipeline.geometry.template_file import read_template
from pipeline.geometry.texels import Atlas
from pipeline.lighting.environment import Environment
from pipeline.lighting.environment_lobes import prefilter
from pipeline.lighting.environment_sh import gather_environment, project_environment
from pipeline.lighting.irradiance import trace_irradiance
from pipeline.lighting.light_scene import Lights
from pipeline.lighting.lobes import LOBE_CONSTANT
from pipeline.lighting.visibility import ORIGIN_OFFSET, Occluders
from pipeline.lighting.zonal import DEGREES
from pipeline.stages.unwrap_atlas import build_atlas

HEAD_M, HEAD_TEXELS = 0.3, 256
"""Height of the head, neck included, and texels per side of its map."""

PIXELS_AT_ONCE = 1 << 16
"""Of a panorama, for sums over all of them."""


@dataclass(frozen=True)
class Sphere:
    """Least-squares sphere through points; `off` has each point's distance from it, outwards."""

    center: Float64[np.ndarray, " 3"]
    radius: float
    off: Float64[np.ndarray, " points"]


def fit_sphere(points: Float64[np.ndarray, "points 3"]) -> Sphere:
    """Fit a sphere so that the squared distances of the points from it are least."""

    def off(sphere: np.ndarray) -> np.ndarray:
        return np.linalg.norm(points - sphere[:3], axis=1) - sphere[3]

    middle = points.mean(0)
    found = least_squares(off, [*middle, np.linalg.norm(points - middle, axis=1).mean()], xtol=1e-12).x
    return Sphere(found[:3], float(found[3]), off(found))


def nearest_distances(points: Float64[np.ndarray, "points 3"]) -> Float64[np.ndarray, " points"]:
    """Distance of each point to the next one."""
    return cKDTree(points).query(points, k=2)[0][:, 1]


def unwrapped_head(path: Path, layout: str = "auto") -> Atlas:
    """The texel map of a head scan that is scaled to `HEAD_M`, its box centred on the origin."""
    height = np.ptp(read_template(path, 1.0).vertices_rest[:, 1])
    template = read_template(path, HEAD_M / height)
    middle = (template.vertices_rest.min(0) + template.vertices_rest.max(0)) / 2
    template = replace(template, vertices_rest=template.vertices_rest - middle)
    return build_atlas(template, UnwrapAtlas(size=HEAD_TEXELS, layout=layout), path)


def even_deviation(
    points: Float64[np.ndarray, "points 3"], lights: Float64[np.ndarray, "lights 3"], share: float = 0.95
) -> float:
    """|L(v) / L(centre) - 1| that a share of all pairs of point and light stay within, in percent."""
    center = ((lights - points.mean(0)) ** 2).sum(1)
    each = ((lights - points[:, None]) ** 2).sum(2)
    return 100 * float(np.quantile(np.abs(center / each - 1), share))


def seen_by_definition(
    atlas: Atlas, texels: Int[np.ndarray, " n"], lights: Float64[np.ndarray, "m 3"], lift: float = 0.0
) -> Bool[np.ndarray, "n m"]:
    """Whether a texel sees a light, by every triangle, in float64 (Moeller and Trumbore 1997), without a tree.

    Rays start `lift` above their face.
    """
    points, normals = texel_points(atlas, atlas.rest_vertices, texels)
    points = points + lift * normals
    a, b, c = atlas.rest_vertices.astype(np.float64)[atlas.faces].transpose(1, 0, 2)
    first, second, seen = b - a, c - a, np.zeros((len(texels), len(lights)), bool)
    for row, (texel, point, normal) in enumerate(zip(texels, points, normals, strict=True)):
        above = np.flatnonzero((lights - point) @ normal > -lift)  # of the face, not of where rays start
        ways, start = lights[above] - point, point - a
        across = np.cross(start, first)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = 1 / (ways @ np.cross(second, first).T)
            u, v = ways @ np.cross(second, start).T * scale, ways @ across.T * scale
            t = (second * across).sum(1) * scale
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < 1)
        hit[:, atlas.face[texel]] = False  # no surface hides itself
        seen[row, above] = ~hit.any(1)
    return seen


@dataclass(frozen=True)
class TracedHead:
    """Normalised irradiance of texels under equal lights by the pipeline, and by definition.

    Attributes:
        ours: by the pipeline's tracer.
        lifted: by definition, of rays that start as far above their face as the tracer's.
        exact: by definition, of rays that start on it.
        rays_off: rays from the surface itself that the lift makes end otherwise.
        lift: metres.
    """

    ours: Float64[np.ndarray, " n"]
    lifted: Float64[np.ndarray, " n"]
    exact: Float64[np.ndarray, " n"]
    rays_off: int
    lift: float


def irradiance_both_ways(atlas: Atlas, texels: Int[np.ndarray, " n"], lights: Float64[np.ndarray, "m 3"]) -> TracedHead:
    """Normalised irradiance of equal lights by the pipeline, and with `seen_by_definition`."""
    points, normals = texel_points(atlas, atlas.rest_vertices, texels)
    occluders = Occluders(atlas.rest_vertices, atlas.faces)
    traced = trace_irradiance(occluders, points, normals, Lights(lights, np.ones(len(lights)))).values
    lift = ORIGIN_OFFSET * occluders.half_extent
    lifted, exact = (seen_by_definition(atlas, texels, lights, height) for height in (lift, 0.0))
    arriving = 1 / ((lights - points[:, None]) ** 2).sum(2)
    arriving /= arriving.sum(1, keepdims=True)
    sums = ((arriving * seen).sum(1) for seen in (lifted, exact))
    return TracedHead(traced, *sums, int((lifted != exact).sum()), lift)


def summed(
    environment: Environment, axes: np.ndarray, weight_of_cosine: Callable[[np.ndarray], np.ndarray]
) -> Float64[np.ndarray, "n 3"]:
    """Sum over all pixels of irradiance times a weight of the cosine to each axis."""
    directions, light = environment.directions().reshape(-1, 3), environment.irradiances()
    return sum(
        weight_of_cosine(axes @ directions[start : start + PIXELS_AT_ONCE].T) @ light[start : start + PIXELS_AT_ONCE]
        for start in range(0, len(light), PIXELS_AT_ONCE)
    )


def relative_rms(found: np.ndarray, true: np.ndarray) -> float:
    """Root mean square of the error over that of the truth."""
    return float(np.sqrt(((found - true) ** 2).mean() / (true**2).mean()))


def cosine_by_degree() -> Float64[np.ndarray, " degrees"]:
    """What a clamped cosine keeps of each degree: 2 pi int_0^1 t P_l(t) dt (Funk and Hecke)."""
    t, weight = np.polynomial.legendre.leggauss(DEGREES)
    return np.pi * np.polynomial.legendre.legvander((t + 1) / 2, DEGREES - 1).T @ (weight * (t + 1) / 2)


def matte_errors(environment: Environment, turns: Float64[np.ndarray, "n 3 3"]) -> float:
    """Relative rms error of a matte surface's light by harmonics; normals are the columns of rotations."""
    gathered = gather_environment(torch.from_numpy(turns), torch.from_numpy(project_environment(environment))).numpy()
    matte = np.einsum("nadc,d->nac", gathered, cosine_by_degree()).reshape(-1, 3)
    return relative_rms(matte, summed(environment, turns.transpose(0, 2, 1).reshape(-1, 3), lambda x: np.maximum(x, 0)))


def lobe_errors(environment: Environment, axes: np.ndarray, sigmas: tuple[float, ...]) -> list[float]:
    """Relative rms error of prefiltered lobes of each roughness (RFGCA 13)."""
    ladder, errors = prefilter(environment), []
    for sigma in sigmas:
        true = summed(environment, axes, lambda x, s=sigma: np.exp(-0.5 * (np.arccos(np.clip(x, -1, 1)) / s) ** 2))
        wide = torch.full((len(axes),), sigma)
        found = ladder.look_up(torch.from_numpy(axes).float(), wide).double().numpy()
        errors.append(relative_rms(found, LOBE_CONSTANT / sigma * true))
    return errors
