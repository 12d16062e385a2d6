"""Meshes of a set that ships none: made by another program, named by a setting."""

from __future__ import annotations

import re
from collections.abc import Collection
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.errors import InputError, listed
from pipeline.capture.archives import read_bytes
from pipeline.datasets.imported_capture import TrackedMeshes
from pipeline.geometry.mesh_files import Mesh, decode_mesh

STILL = np.eye(3, 4).ravel().tolist()


def meshes_beside(setting: str, frames: Collection[int], made_by: str) -> TrackedMeshes:
    """The meshes that `import_capture.mesh` names, in the world, metres.

    One mesh is that of all frames. Of a folder each file is that of the frame in its name.

    Args:
        frames: numbers of the frames that there are.
        made_by: what makes such meshes of the set, for messages.

    Raises:
        InputError: if none is named, a file is no mesh with faces, or none is of a frame.
    """
    where = "import_capture.mesh"
    expected = "an .obj or .ply in the frame of the set's cameras, in metres, or a folder of them (000015.ply)"
    if not setting or not Path(setting).exists():
        raise InputError(f"{where}: expected {expected}, as the set ships none, found {setting or 'none'}; {made_by}")
    place = Path(setting)
    if place.is_file():
        rest, name = _faced(place), f"still{place.suffix.lower()}"
        table = pd.DataFrame({"frame": sorted(frames), "path": name, "world_from_mesh": [STILL] * len(frames)})
        return TrackedMeshes(table, 1.0, rest, elsewhere={name: place})
    numbered = {int(re.sub(r"\D", "", path.stem) or -1): path for path in sorted(place.glob("*.*"))
                if path.suffix.lower() in (".obj", ".ply")}  # fmt: skip
    kept = {frame: numbered[frame] for frame in sorted(frames) if frame in numbered}
    if not kept:
        found = listed([path.name for path in numbered.values()]) or "none"
        raise InputError(f"{where}: expected {expected}, named after images' numbers, found {found} in {place}")
    rest = _faced(next(iter(kept.values())))
    table = pd.DataFrame({"frame": list(kept), "path": [path.name for path in kept.values()]})
    elsewhere = {path.name: path for path in kept.values()}
    return TrackedMeshes(table.assign(world_from_mesh=[STILL] * len(kept)), 1.0, rest, "fitted", elsewhere)


def _faced(path: Path) -> Mesh:
    mesh = decode_mesh(read_bytes(path), path)
    if not len(mesh.faces):
        raise InputError(f"{path}: expected a mesh with faces, found vertices alone")
    return mesh
