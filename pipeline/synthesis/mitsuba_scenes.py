"""Scenes for Mitsuba 3 (https://mitsuba.readthedocs.io), and its scalar renderer.

Each process renders on one thread. Mitsuba is imported inside functions only: it takes a second, and everything else in
this package works without it. Rendered images are radiance, linear RGB, with coverage in the fourth channel.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Literal

import numpy as np
from jaxtyping import Float32, Float64, Int64

from pipeline.synthesis.lens import LensView

SCALAR, LLVM = "scalar_rgb", "llvm_ad_rgb"
"""Variants of Mitsuba: one ray at a time, and packets of rays in compiled kernels, which needs an LLVM library."""

COAT_IOR = 1.5
"""Refractive index of a subject's coat: typical of skin oil, varnish and polymers."""

NO_ROULETTE = 1000
"""Path depth at which Russian roulette would start. Never, since it only adds noise to paths this short."""

SAMPLE_SET_SIZES = (64, 16, 4, 1)
"""Sizes of low-discrepancy sets: powers of four from 4 on. Other sample counts are sums of several sets."""


SEEDS_PER_LIGHT = 1009
"""More than the sets of samples of one light take: each set has its own seed."""


def mitsuba() -> Any:
    """The module `mitsuba` with its variant chosen and one rendering thread.

    So results do not depend on the host. The variant is `scalar_rgb` but within `llvm_variant`.
    """
    import drjit
    import mitsuba as mi

    if mi.variant() not in (SCALAR, LLVM):
        mi.set_variant(SCALAR)
        drjit.set_thread_count(1)
    return mi


@contextmanager
def llvm_variant() -> Iterator[None]:
    """Let `mitsuba` be the vectorized variant; scenes of one variant are of no use to the other."""
    mi = mitsuba()
    before = mi.variant()
    mi.set_variant(LLVM)
    try:
        yield
    finally:
        mi.set_variant(before)


def sensor(view: LensView, samples: int) -> dict[str, Any]:
    """Mitsuba sensor: the pinhole camera that renders a view's window.

    Each pixel gets one low-discrepancy set of `samples` paths.
    """
    mi = mitsuba()
    camera = view.camera
    # Mitsuba's camera looks along +z like OpenCV's, but its x points left and its y up.
    world_from_sensor = np.eye(4)
    world_from_sensor[:3, :3] = camera.R.T @ np.diag([-1.0, -1.0, 1.0])
    world_from_sensor[:3, 3] = camera.center
    x, y, width, height = view.crop
    return {
        "type": "perspective",
        "fov": float(np.degrees(2 * np.arctan(view.film[0] / 2 / view.focal))),
        "fov_axis": "x",
        "near_clip": 0.01,
        "to_world": mi.ScalarTransform4f(world_from_sensor),
        "film": {
            "type": "hdrfilm", "width": view.film[0], "height": view.film[1],
            "crop_offset_x": x, "crop_offset_y": y, "crop_width": width, "crop_height": height,
            "pixel_format": "rgba", "component_format": "float32", "rfilter": {"type": "box"},
        },
        "sampler": {"type": "ldsampler" if samples > 1 else "independent", "sample_count": samples},
    }  # fmt: skip


def render(scene: Any, view: LensView, samples: int, seed: int) -> Float32[np.ndarray, "crop_height crop_width 4"]:
    """Render a view's window: radiance and coverage, about `samples` paths per fine pixel."""
    mi = mitsuba()
    size = next(size for size in SAMPLE_SET_SIZES if size <= max(samples, 1))
    passes = max(1, round(samples / size))
    loaded = mi.load_dict(sensor(view, size))
    image: Any = 0.0
    for index in range(passes):
        part = mi.render(scene, sensor=loaded, seed=(seed + index) % 2**31)
        image = image + np.array(part, dtype=np.float32)
    return image / np.float32(passes)


def render_each_light(
    scene: Any, view: LensView, positions: Float64[np.ndarray, "n 3"], intensities: Float64[np.ndarray, " n"],
    samples: int, seed: int,
) -> Float32[np.ndarray, "crop_height crop_width 4"]:  # fmt: skip
    """The sum of pictures by one light each, about `samples` paths per fine pixel and light.

    Paths that draw one of n lights leave noise of how much those differ; these have none of it.

    Args:
        scene: of `lit_scene` with one light, which is moved.
    """
    light, image = mitsuba().traverse(scene), np.zeros(0, np.float32)
    for index, (position, intensity) in enumerate(zip(positions, intensities, strict=True)):
        light["light_0000.position"] = position.tolist()
        light["light_0000.intensity.value"] = [float(intensity)] * 3
        light.update()
        part = render(scene, view, samples, seed + SEEDS_PER_LIGHT * index)
        image = part if index == 0 else image + part
    image[..., 3] /= len(positions)  # coverage, seen as often
    return image


def triangle_mesh(
    bsdf: dict[str, Any],
    vertices: Float64[np.ndarray, "v 3"],
    faces: Int64[np.ndarray, "f 3"],
    uv: Float64[np.ndarray, "v 2"],
    normals: Float64[np.ndarray, "v 3"] | None = None,
    emitter: dict[str, Any] | None = None,
    interior: dict[str, Any] | None = None,
) -> Any:
    """A Mitsuba mesh with texture coordinates (v down).

    Smooth normals, an emitter and a medium inside are optional.
    """
    mi = mitsuba()
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf)
    if emitter is not None:
        properties["emitter"] = mi.load_dict(emitter)
    if interior is not None:
        properties["interior"] = mi.load_dict(interior)
    mesh = mi.Mesh(
        "mesh", len(vertices), len(faces),
        has_vertex_normals=normals is not None, has_vertex_texcoords=True, props=properties,
    )  # fmt: skip
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = np.ravel(vertices).astype(np.float32)
    if normals is not None:
        parameters["vertex_normals"] = np.ravel(normals).astype(np.float32)
    parameters["vertex_texcoords"] = np.ravel(uv).astype(np.float32)
    parameters["faces"] = np.ravel(faces).astype(np.uint32)
    parameters.update()
    return mesh


def bitmap_texture(texture: Float32[np.ndarray, "h w 3"], filter_type: str) -> dict[str, Any]:
    """A texture of linear values, row 0 at v = 0."""
    mi = mitsuba()
    return {
        "type": "bitmap", "bitmap": mi.Bitmap(np.ascontiguousarray(texture)), "raw": True,
        "wrap_mode": "clamp", "filter_type": filter_type,
    }  # fmt: skip


def mesh_scene(meshes: Sequence[Any]) -> Any:
    """Meshes without lights, to be asked what rays hit."""
    return mitsuba().load_dict({"type": "scene", **{f"mesh_{index}": mesh for index, mesh in enumerate(meshes)}})


def lit_scene(
    meshes: Sequence[Any],
    light_positions: Float64[np.ndarray, "n 3"],
    intensities: Float64[np.ndarray, " n"],
    max_depth: int,
    integrator: Literal["path", "volpath"] = "path",
) -> Any:
    """Meshes under point lights of the given radiant intensities, on black.

    Paths have up to `max_depth` edges. Media need the `volpath` integrator; it counts a scattering as an edge's end,
    but not the crossing of a surface.
    """
    mi = mitsuba()
    content: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": integrator, "max_depth": max_depth, "rr_depth": NO_ROULETTE},
        **{f"mesh_{index}": mesh for index, mesh in enumerate(meshes)},
    }
    for index, (position, intensity) in enumerate(zip(light_positions, intensities, strict=True)):
        content[f"light_{index:04d}"] = {
            "type": "point", "position": position.tolist(),
            "intensity": {"type": "rgb", "value": [float(intensity)] * 3},
        }  # fmt: skip
    return mi.load_dict(content)


def coated_mesh(
    texture: np.ndarray,
    gloss_alpha: float,
    vertices: np.ndarray,
    normals: np.ndarray,
    faces: np.ndarray,
    uv: np.ndarray,
    ior: float = COAT_IOR,
) -> Any:
    """A subject's surface: a diffuse albedo texture under a rough dielectric coat.

    `gloss_alpha` is the width of the coat's GGX lobe.
    """
    bsdf = {
        "type": "roughplastic", "distribution": "ggx", "alpha": gloss_alpha, "int_ior": ior,
        "diffuse_reflectance": bitmap_texture(texture, "bilinear"),
    }  # fmt: skip
    return triangle_mesh(bsdf, vertices, faces, uv, normals)


def mirror_ball_scene(
    center: Float64[np.ndarray, "3"], radius: float, light: Float64[np.ndarray, "3"], light_radius: float
) -> Any:
    """A perfect mirror ball and one spherical light of radiance 1, hidden from direct view."""
    mi = mitsuba()
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2, "rr_depth": NO_ROULETTE, "hide_emitters": True},
            "ball": {"type": "sphere", "center": center.tolist(), "radius": radius, "bsdf": {"type": "conductor"}},
            "light": {
                "type": "sphere", "center": light.tolist(), "radius": light_radius,
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 1.0}},
            },
        }
    )  # fmt: skip


def hit_distances(scene: Any, origin: Float64[np.ndarray, "3"], directions: Float64[np.ndarray, "n 3"]) -> np.ndarray:
    """Distance [n] to the first surface along each direction, infinity where there is none."""
    mi = mitsuba()
    if mi.variant() == LLVM:
        rays = mi.Ray3f(mi.Point3f(*origin.tolist()), mi.Vector3f(*directions.T.astype(np.float32)))
        return np.array(scene.ray_intersect_preliminary(rays).t, np.float64)
    start = origin.tolist()
    return np.array([float(scene.ray_intersect_preliminary(mi.Ray3f(start, d.tolist())).t) for d in directions])
