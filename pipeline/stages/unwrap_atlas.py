"""Lay the template's surface out on a square map of texels.

Each texel shows a point of the surface and becomes one Gaussian.

The template's own texture coordinates serve if they lie in [0, 1], hardly overlap and leave hardly any surface without
area in the map; otherwise xatlas cuts and packs new ones, deterministically, and the log says why. Writes
atlas.safetensors (`pipeline.geometry.texels.Atlas`), a picture atlas.png and template.glb, the rest mesh with the map's
coordinates, to look at.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64
from PIL import Image

from pipeline.base.command import run_as_command
from pipeline.base.errors import InputError
from pipeline.base.files import read_json, written_whole
from pipeline.config.unwrap_atlas import UnwrapAtlas
from pipeline.geometry.atlas import reasons_against, sampled_atlas, unwrap_faces, uv_areas
from pipeline.geometry.cameras import read_cameras
from pipeline.geometry.mesh import area_vectors, is_closed, signed_volume, weld_vertices
from pipeline.geometry.skin import Template
from pipeline.geometry.template_file import read_template
from pipeline.geometry.template_regions import head_of_skin, read_regions
from pipeline.geometry.texels import Atlas, write_atlas
from pipeline.metrics.output_errors import pixel_size_m

log = logging.getLogger("unwrap_atlas")

USED_BY_NEW_CHARTS = 0.45
"""Share of a map that new charts cover: 0.41 to 0.5 on bodies and heads."""

LEAST_SIZE = 64
"""Texels per side at least, where pixels decide: below, charts hardly fit beside each other."""

PICTURE_PIXELS = 1024
"""Least side of the chart picture: thin triangles stay visible."""


def run(
    *, capture: Path, index: Path, out: Path, cameras: Path | None = None, settings: UnwrapAtlas = UnwrapAtlas(),
) -> None:  # fmt: skip
    """Lay the template's surface out on a square map and tabulate its texels.

    Args:
        capture: the capture's folder; template paths are relative to it.
        index: folder written by index_capture.
        out: results folder of the subject; gets atlas.safetensors, atlas.png and template.glb.
        cameras: rig.json, at sensor resolution, in any frame: what a pixel covers decides the map's size, if that is
            not given.
        settings: numbers and modes.
    """
    content = read_json(index / "capture.json")
    described = content["template"]
    path = capture / described["mesh"]
    template = read_template(path, described["scale_to_m"])
    if settings.size is None:
        if cameras is None:
            raise InputError("unwrap_atlas.size: expected a number, as --cameras is not given, found none")
        pixel_m = pixel_size_m(read_cameras(cameras)) * float(content["images"]["downsample_from_sensor"])
        size = fitting_size(template, settings.texel_pixels * pixel_m, settings.most)
        log.info("%.2f mm per pixel at the subject: %d texels per side", 1e3 * pixel_m, size)
        settings = settings.model_copy(update={"size": size})
    labels, keypoints = (described.get(name) for name in ("regions", "keypoints"))
    regions = head_of_skin(template, capture / keypoints if keypoints else None)
    regions |= read_regions(capture / labels) if labels else {}
    atlas = replace(build_atlas(template, settings, path), regions=regions)
    measures = measure_atlas(atlas)
    log.info("%s", measures)
    write_atlas(out / "atlas.safetensors", atlas)
    _draw(out / "atlas.png", atlas, measures)
    _write_mesh(out / "template.glb", atlas)


def fitting_size(template: Template, texel_m: float, most: int) -> int:
    """Texels per side, in multiples of 8, so that a texel is about so large on the surface."""
    area_m2 = np.linalg.norm(area_vectors(template.vertices_rest, template.faces), axis=1).sum()
    if template.uv is not None and not reasons_against(template.vertices_rest, template.faces, template.uv, most):
        used = float(np.abs(uv_areas(np.clip(template.uv, 0, 1)[template.faces])).sum())
    else:
        used = USED_BY_NEW_CHARTS
    return int(np.clip(8 * round(float(np.sqrt(area_m2 / used)) / texel_m / 8), LEAST_SIZE, most))


def build_atlas(template: Template, settings: UnwrapAtlas, path: Path) -> Atlas:
    """The texel map of a template; `path` is named in complaints.

    Raises:
        InputError: if the faces look inwards, the map stays empty, or the template's own coordinates are asked for and
            unusable.
    """
    vertices, faces = template.vertices_rest, template.faces
    weld = weld_vertices(vertices, faces)
    if is_closed(faces, weld) and signed_volume(vertices, faces) < 0:
        raise InputError(
            f"{path}: expected faces that look outwards, found them all inwards; flip the normals on export"
        )
    uv = _layout(template, settings, path)
    atlas = sampled_atlas(vertices, faces, uv, weld, settings.size)
    if not atlas.texel_count:
        raise InputError(f"{path}: expected the surface to cover a texel, found none; make unwrap_atlas.size larger")
    return atlas


def _layout(template: Template, settings: UnwrapAtlas, path: Path) -> np.ndarray:
    """Coordinates [faces, 3, 2] float32 per face corner: the template's own or new ones."""
    reasons = reasons_against(template.vertices_rest, template.faces, template.uv, settings.size)
    if settings.layout == "template" and reasons:
        raise InputError(
            f"{path}: expected usable texture coordinates, found: {'; '.join(reasons)}; set layout to auto"
        )
    if settings.layout != "new" and not reasons:
        log.info("using the template's own texture coordinates")
        return np.clip(template.uv, 0, 1).astype(np.float32)[template.faces]
    log.info("cutting new charts: %s", "; ".join(reasons) or "layout is 'new'")
    return unwrap_faces(template.vertices_rest, template.faces, settings.size, settings.padding)


@dataclass(frozen=True)
class AtlasMeasures:
    """Measures of a map.

    `texel_mm`: per face, the side of a square of the surface as large as one texel, NaN without.
    """

    texels: int
    use: float
    charts: int
    mean_texel_mm: float
    scale_spread: float
    stretch_95: float
    uncovered: float
    texel_mm: Float64[np.ndarray, " f"]

    def __str__(self) -> str:
        return (
            f"{self.texels} texels ({self.use:.0%} of the map) in {self.charts} charts, "
            f"{self.mean_texel_mm:.2f} mm per texel, size spread (95 % to 5 %) {self.scale_spread:.2f}, "
            f"stretch (95 %) {self.stretch_95:.2f}, {self.uncovered:.2%} of the surface in faces without a texel"
        )


def measure_atlas(atlas: Atlas) -> AtlasMeasures:
    """Measure texel sizes on the rest surface, and stretch.

    The stretch is the ratio of the singular values of dP/d(u, v) per face, from the metric tensor (Sander et al. 2001,
    Texture Mapping Progressive Meshes, section 3). 2001, Texture Mapping Progressive Meshes, section 3).
    """
    corners, uv = atlas.rest_vertices.astype(np.float64)[atlas.faces], atlas.uv.astype(np.float64)
    area, map_area = np.linalg.norm(area_vectors(atlas.rest_vertices, atlas.faces), axis=1), np.abs(uv_areas(uv))
    shown = np.bincount(atlas.face, minlength=len(atlas.faces))
    with np.errstate(divide="ignore", invalid="ignore"):
        texel_mm = np.where(map_area > 0, 1e3 * np.sqrt(area / map_area) / atlas.size, np.nan)
        duv = np.stack([uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]], 2)
        dp = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], 2)
        clear = shown > 0
        singular = np.linalg.svd(dp[clear] @ np.linalg.inv(duv[clear]), compute_uv=False)
    five, ninety_five = np.percentile(texel_mm[atlas.face], [5, 95])
    return AtlasMeasures(
        atlas.texel_count, atlas.texel_count / atlas.size**2, len(np.unique(atlas.chart)),
        float(texel_mm[atlas.face].mean()), float(ninety_five / five),
        float(np.percentile(np.repeat(singular[:, 0] / singular[:, 1], shown[clear]), 95)),
        float(area[~clear].sum() / area.sum()), texel_mm,
    )  # fmt: skip


def _chart_image(atlas: Atlas) -> np.ndarray:
    """Charts in colours with the wireframe over them, uint8 RGB [pixels, pixels, 3]."""
    import matplotlib  # It draws when the map is done, and so does trimesh write: together a second to import.

    palette = matplotlib.colormaps["tab20"](np.arange(20))[:, :3]
    image = np.ones((atlas.size, atlas.size, 3))
    image[atlas.texel[:, 0], atlas.texel[:, 1]] = palette[np.unique(atlas.chart, return_inverse=True)[1] % len(palette)]
    factor = -(-PICTURE_PIXELS // atlas.size)
    image = np.ascontiguousarray((image * 255).astype(np.uint8).repeat(factor, 0).repeat(factor, 1))
    # cv2 counts from pixel centres and takes fixed-point corners with `shift` fractional bits.
    corners = np.round((atlas.uv * atlas.size * factor - 0.5) * 16).astype(np.int32)
    cv2.polylines(image, list(corners), isClosed=True, color=(60, 60, 60), lineType=cv2.LINE_AA, shift=4)
    return image


def _draw(path: Path, atlas: Atlas, measures: AtlasMeasures) -> None:
    """atlas.png: charts with the wireframe, and the size of the texels on the body."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15, 7.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.imshow(_chart_image(atlas), extent=(0, atlas.size, atlas.size, 0))
    left.set_title(
        f"{measures.charts} charts, {measures.texels} texels, {measures.use:.0%} of {atlas.size} x {atlas.size}"
    )
    sizes = atlas.to_map(measures.texel_mm[atlas.face], np.nan)
    right.set_title(f"texel size on the surface, mean {measures.mean_texel_mm:.2f} mm")
    shown = right.imshow(sizes, extent=(0, atlas.size, atlas.size, 0), interpolation="nearest")
    figure.colorbar(shown, ax=right, label="mm")
    with written_whole(path) as temporary:
        figure.savefig(temporary, dpi=110, format="png")


def _write_mesh(path: Path, atlas: Atlas) -> None:
    """The rest mesh, split along the map's seams, textured with the chart picture."""
    import trimesh

    keys = np.concatenate([atlas.faces.reshape(-1, 1), atlas.uv.reshape(-1, 2)], 1)
    rows, corner = np.unique(keys, axis=0, return_inverse=True)
    # trimesh keeps v pointing up and turns it over when it writes glTF.
    uv = rows[:, 1:] * (1, -1) + (0, 1)
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=Image.fromarray(_chart_image(atlas)), metallicFactor=0.0
    )
    mesh = trimesh.Trimesh(
        atlas.rest_vertices[rows[:, 0].astype(int)], corner.reshape(-1, 3), process=False,
        visual=trimesh.visual.TextureVisuals(uv, material=material),
    )  # fmt: skip
    with written_whole(path) as temporary:
        temporary.write_bytes(mesh.export(file_type="glb"))


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
