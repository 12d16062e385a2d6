"""Gaussians as glTF with the extension KHR_gaussian_splatting.

Programs that do not know it show coloured points.

Source: Khronos, KHR_gaussian_splatting, release candidate of 2026: kernel ellipse, scales linear, rotations x, y, z, w,
opacities in [0, 1], spherical harmonics of degree 0. Axes are glTF's and this project's: metres, y up.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pygltflib

from pipeline.base.color import linear_from_srgb
from pipeline.export.glb import GlbFile
from pipeline.rendering.splat_ply import SH_0, Splats, stored_splats

EXTENSION = "KHR_gaussian_splatting"
DESCRIBED = {
    "kernel": "ellipse", "colorSpace": "srgb_rec709_display", "projection": "perspective",
    "sortingMethod": "cameraDistance",
}  # fmt: skip


def write_gaussian_glb(path: Path, splats: Splats) -> None:
    """Write a .glb; colours are clipped to [0, 1] and encoded as sRGB.

    Those of the points, for programs without splats, are linear, as glTF asks.
    """
    stored, file = stored_splats(splats), GlbFile()
    shown = linear_from_srgb(SH_0 * stored.coefficients + 0.5).clip(0, 1)
    attributes = {
        "POSITION": file.add_vertices(stored.means, bounded=True),
        "COLOR_0": file.add_vertices(np.concatenate([shown, stored.opacities[:, None]], 1)),
        f"{EXTENSION}:ROTATION": file.add_vertices(np.roll(stored.quaternions, -1, axis=1)),
        f"{EXTENSION}:SCALE": file.add_vertices(np.exp(stored.log_scales)),
        f"{EXTENSION}:OPACITY": file.add_vertices(stored.opacities.clip(0, 1)),
        f"{EXTENSION}:SH_DEGREE_0_COEF_0": file.add_vertices(stored.coefficients),
    }
    points = pygltflib.Primitive(
        attributes=pygltflib.Attributes(**attributes), mode=pygltflib.POINTS, extensions={EXTENSION: DESCRIBED}
    )
    file.use(EXTENSION)
    file.document.meshes.append(pygltflib.Mesh(name="gaussians", primitives=[points]))
    file.add_node(pygltflib.Node(name="gaussians", mesh=0))
    file.write(path)
