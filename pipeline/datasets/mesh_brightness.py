"""Meshes of a set without masks, looked for in images that are bright where the subject is."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence

import numpy as np

from pipeline.base.spread import evenly
from pipeline.capture.images import ImageSource
from pipeline.datasets.imported_capture import ImageStore, TrackedMeshes
from pipeline.datasets.mask_agreement import HALF, PROVEN_CAMERAS, posed_vertices
from pipeline.geometry.cameras import Camera
from pipeline.geometry.signed_distance import draw_silhouette

log = logging.getLogger(__name__)


def say_brightness(
    source: ImageSource, store: ImageStore, cameras: Mapping[str, Camera], meshes: TrackedMeshes, lit: Sequence[int]
) -> str:
    """A sentence on how bright fully lit images are in the projected mesh, and beside it.

    It is logged, with a warning if beside is brighter. Medians, which the lights themselves do not reach. It is no
    proof: a subject's clothes are as bright as its skin.

    Args:
        source: reads the store's images.
        lit: frames with all lights on; the middle one of those with a mesh is looked at.
    """
    known = [frame for frame in lit if frame in set(meshes.table.frame)]
    if not known:
        return "not checked: no fully lit image has a mesh"
    frame = known[len(known) // 2]
    table = store.table[store.table.frame == frame].set_index("camera")
    vertices, inside, beside = posed_vertices(source.folder, meshes, frame), [], []
    for name in evenly(sorted(table.index), PROVEN_CAMERAS):
        camera = cameras[name].downsampled(float(store.downsample_from_sensor))
        covered = draw_silhouette(camera, vertices, meshes.rest.faces) >= HALF
        light = source.read(table.path[name], frame).mean(2)
        inside.append(light[covered])
        beside.append(light[~covered])
    values = [float(np.median(np.concatenate(part))) if sum(map(len, part)) else 0.0 for part in (inside, beside)]
    shown = f"{values[0]:.4f} of the full scale in the projected mesh, {values[1]:.4f} beside it"
    said = f"fully lit image {frame} has {shown}"
    log.info("%s", said)
    if values[0] <= values[1]:
        log.warning("%s: is the mesh in the frame of the cameras?", said)
    return f"{said} (medians)"
