"""Observations of texels in training images: colours, and from where they were seen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from jaxtyping import Float, Float32, Float64, Int64

from pipeline.base.color import corrected
from pipeline.capture.images import ImageSource
from pipeline.geometry.cameras import Camera
from pipeline.geometry.depth_maps import draw_depth, seen_well
from pipeline.geometry.sampling import sample_bilinear
from pipeline.geometry.surface_points import SurfacePoints
from pipeline.geometry.texels import Atlas
from pipeline.lighting.direct_light import smooth_normals

STEP_PIXELS = 5.0
"""Depths of neighbouring pixels on one surface differ by less, in pixel widths on the subject: 3.2 where it is seen at
72 degrees, the steepest that counts, and 4.5 across a diagonal. What lies further apart are two surfaces."""


BRIGHTEST = 0.95
"""Of full scale: near it sensors clip, and a clipped highlight looks like a material that is none."""


@dataclass(frozen=True)
class SeenTexels:
    """Observations of P texels in F frames.

    Attributes:
        texels: index in the atlas of each texel that was looked for.
        frames: frame numbers.
        points, normals: where the texels are in each frame, metres; unit or zero.
        frame, point: of each observation, indices into `frames` and `texels`.
        color: linear RGB, black level and the camera's own colours removed.
        to_camera: unit vectors.
        pixel_m: size of a pixel at the point, metres.
    """

    texels: Int64[np.ndarray, " P"]
    frames: Int64[np.ndarray, " F"]
    points: Float64[np.ndarray, "F P 3"]
    normals: Float64[np.ndarray, "F P 3"]
    frame: Int64[np.ndarray, " n"]
    point: Int64[np.ndarray, " n"]
    color: Float64[np.ndarray, "n 3"]
    to_camera: Float64[np.ndarray, "n 3"]
    pixel_m: Float64[np.ndarray, " n"]


def observe_texels(
    source: ImageSource,
    images: pd.DataFrame,
    cameras: Mapping[str, Camera],
    colors: Mapping[str, Float64[np.ndarray, "3 columns"]],
    atlas: Atlas,
    texels: Int64[np.ndarray, " P"],
    vertices: Mapping[int, Float32[np.ndarray, "v 3"]],
) -> SeenTexels:
    """Look the texels up in all images given, wherever they are seen well.

    Images are taken as recorded: points are projected through the lens, and colours corrected afterwards.

    Args:
        source: the capture's images.
        images: camera, frame and path of each image.
        cameras: at the resolution of the images.
        colors: corrected-from-raw, of cameras that have one.
        vertices: posed template of each frame, metres.
    """
    surface = SurfacePoints(atlas.corners[texels].astype(np.int64), atlas.barycentric[texels].astype(np.float64))
    faces, weld = atlas.faces.astype(np.int64), atlas.weld.astype(np.int64)
    frames = np.unique(images.frame.to_numpy(np.int64))
    meshes = [vertices[int(frame)].astype(np.float64) for frame in frames]
    points = np.stack([surface.carried(mesh) for mesh in meshes]) if meshes else np.zeros((0, len(texels), 3))
    normals = [smooth_normals(mesh, faces, weld, surface) for mesh in meshes]
    columns: dict[str, list[np.ndarray]] = {name: [] for name in ("frame", "point", "color", "to_camera", "pixel_m")}
    for row in images.itertuples():
        at, camera = int(np.searchsorted(frames, row.frame)), cameras[row.camera]
        distance = float(np.linalg.norm(camera.center - points[at].mean(0)))
        step_m = STEP_PIXELS * distance / np.sqrt(camera.K[0, 0] * camera.K[1, 1])
        depth_map = draw_depth(camera, meshes[at], faces)
        chosen = np.flatnonzero(seen_well(camera, depth_map, points[at], normals[at], float(step_m)))
        image = source.read(row.path, row.frame)
        pixels, depth = camera.project(points[at, chosen])
        color = sample_bilinear(image[None], np.zeros(len(chosen), np.int64), pixels)[0].astype(np.float64)
        found = (color < BRIGHTEST).all(1)  # not where it is no number, either
        way = (camera.center - points[at, chosen])[found]
        columns["frame"].append(np.full(found.sum(), at))
        columns["point"].append(chosen[found])
        columns["color"].append(corrected(color[found], colors.get(row.camera, np.eye(3))))
        columns["to_camera"].append(way / np.linalg.norm(way, axis=1, keepdims=True))
        columns["pixel_m"].append(depth[found] / np.sqrt(camera.K[0, 0] * camera.K[1, 1]))
    if not meshes:
        empty, index = np.zeros((0, 3)), np.zeros(0, np.int64)
        return SeenTexels(texels, frames, points, points, index, index, empty, empty, np.zeros(0))
    joined = {name: np.concatenate(parts) for name, parts in columns.items()}
    return SeenTexels(texels, frames, points, np.stack(normals), **joined)


def texel_turns(atlas: Atlas, normals: Float[np.ndarray, "t 3"]) -> Float64[np.ndarray, " t"]:
    """Root mean square angle, radians, between the normals of each texel and of its neighbours.

    Neighbours are the texels to its right and below; 0 where neither belongs to the same piece of surface.
    """
    index = atlas.to_map(np.arange(len(normals)), outside=-1.0)
    total, count = np.zeros((2, len(normals)))
    for here, there in ((index[:, :-1], index[:, 1:]), (index[:-1], index[1:])):
        both = (here >= 0) & (there >= 0)
        a, b = here[both], there[both]
        same = atlas.chart[a] == atlas.chart[b]
        a, b = a[same], b[same]
        chord = np.linalg.norm(normals[a] - normals[b], axis=1)
        total[a] += (2 * np.arcsin(np.minimum(chord / 2, 1))) ** 2
        count[a] += 1
    return np.sqrt(total / np.maximum(count, 1))
