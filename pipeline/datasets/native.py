"""Writing an imported capture in the native format: small tables, and a link to the set."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd
import yaml

from pipeline.base.errors import InputError
from pipeline.base.files import digest_bytes, digest_file, write_json, write_table, written_whole
from pipeline.base.large_tables import written_pieces
from pipeline.capture.archives import read_bytes
from pipeline.capture.mask_format import PLAIN_MASKS
from pipeline.capture.paths import SOURCE
from pipeline.datasets.imported_capture import OWN_MESH, ImportedCapture, TrackedMeshes
from pipeline.geometry.cameras import write_cameras
from pipeline.geometry.mesh_files import Mesh

TABLES = ("cameras.csv", "frames.csv", "lights.csv", "patterns.csv", "images.parquet", "meshes.parquet",
          "cameras.json", "color.json", "template.glb", "keypoints_2d.parquet", "keypoints.csv", OWN_MESH)  # fmt: skip
"""All that is written beside capture.yaml; without colours there is no color.json, with a set's meshes no OWN_MESH,
without keypoints no tables of them."""


def write_native(out: Path, source: Path, dataset: str, subject: str, found: ImportedCapture) -> None:
    """Write a capture folder whose images lie in `source`; capture.yaml is written last.

    Raises:
        InputError: if the folder holds something that was not imported.
    """
    out.mkdir(parents=True, exist_ok=True)
    link_source(out, source)
    images = found.images.table.assign(
        path=SOURCE + "/" + found.images.table["path"], mask_path=SOURCE + "/" + found.images.table["mask_path"]
    )
    sizes = [
        {"camera": name, "width": width, "height": height, "sensor_width": camera.width, "sensor_height": camera.height}
        for name, camera in found.cameras.items()
        for width, height in [found.images.sizes[name]]
    ]
    write_table(out / "cameras.csv", pd.DataFrame(sizes))
    write_table(out / "frames.csv", found.frames)
    write_table(out / "lights.csv", found.lights)
    write_table(out / "patterns.csv", found.patterns)
    write_table(out / "images.parquet", images)
    write_table(out / "meshes.parquet", mesh_table(out, found.meshes))
    write_cameras(out / "cameras.json", found.cameras)
    if found.colors:
        write_json(out / "color.json", {"cameras": {name: m.tolist() for name, m in found.colors.items()}})
    write_mesh(out / "template.glb", found.meshes.rest)
    if found.keypoints is not None:
        write_table(out / "keypoints.csv", found.keypoints.places)
        with written_pieces(out / "keypoints_2d.parquet") as table:
            for piece in found.keypoints.pieces():
                table.add(piece)
    with written_whole(out / "capture.yaml") as temporary:
        temporary.write_text(yaml.safe_dump(described(out, dataset, subject, found), sort_keys=False))


def mesh_table(out: Path, meshes: TrackedMeshes) -> pd.DataFrame:
    """The table of meshes, its paths relative to the capture; copies those from elsewhere there."""
    if not meshes.in_set:
        write_mesh(out / OWN_MESH, meshes.rest)
        return meshes.table
    places = {path: f"{SOURCE}/{path}" for path in meshes.table["path"]}
    for path, file in meshes.elsewhere.items():
        places[path] = f"meshes/{path}"
        with written_whole(out / places[path]) as temporary:
            temporary.write_bytes(read_bytes(file))
    return meshes.table.assign(path=meshes.table["path"].map(places))


def link_source(out: Path, source: Path) -> None:
    """Make the capture's link to the set, or turn an old one to it.

    Raises:
        InputError: if something else has its name.
    """
    link = out / SOURCE
    if link.exists() and not link.is_symlink():
        raise InputError(f"{link}: expected no such file or folder, as import_capture makes a link; move it away")
    link.unlink(missing_ok=True)
    link.symlink_to(source.resolve(), target_is_directory=True)


def described(out: Path, dataset: str, subject: str, found: ImportedCapture) -> dict[str, Any]:
    """Content of capture.yaml, once the files that it names are written."""
    images, masks, held_out = found.images, found.images.masks, found.held_out
    level = images.black_level
    content: dict[str, Any] = {
        "format": "lightstage-capture/1", "subject": subject, "kind": found.kind, "units": "m", "up": "+y",
        "fps": float(found.fps),
        "images": {
            "table": "images.parquet", "transfer": images.transfer,
            "black_level": float(level) if isinstance(level, int | float) else [float(value) for value in level],
            "downsample_from_sensor": images.downsample_from_sensor,
            **({"reduced": images.reduced} if images.reduced > 1 else {}),
        },
    }  # fmt: skip
    if masks != PLAIN_MASKS or images.clean_plates:
        labels = {} if masks.labels is None else {"labels": list(masks.labels)}
        plates = {"clean_plates": f"{SOURCE}/{images.clean_plates}"} if images.clean_plates else {}
        content["masks"] = {**labels, "enlarged": masks.enlarged, **plates}
    if found.constant_light:
        content["constant_light"] = True
    placed, keypoints = {}, {}
    if found.keypoints is not None:
        placed = {"keypoints": "keypoints.csv"}
        keypoints = {"keypoints_2d": "keypoints_2d.parquet", "keypoints_order": found.keypoints.order}
    chosen = {}
    if held_out.validation_patterns is not None:
        chosen["validation_patterns"] = [int(frame) for frame in held_out.validation_patterns]
    if held_out.validation_cameras is not None:
        chosen["validation_cameras"] = list(held_out.validation_cameras)
    provenance = found.provenance
    return content | {
        "cameras": "cameras.csv", "frames": "frames.csv", "lights": "lights.csv", "patterns": "patterns.csv",
        **keypoints, "template": {"mesh": "template.glb", "scale_to_m": 1.0, **placed},
        "meshes": {
            "table": "meshes.parquet", "motion": found.meshes.motion, "scale_to_m": found.meshes.scale_to_m,
        },
        "calibration": {
            "cameras": {"method": "known", "path": "cameras.json"}, "lights": {"method": "known"},
            "color": {"method": "known", "path": "color.json"} if found.colors else {"method": "none"},
        },
        "splits": {
            "test_cameras": list(held_out.cameras), "test_frames": [int(frame) for frame in held_out.frames],
            "test_segments": list(held_out.segments), "test_patterns": [int(frame) for frame in held_out.patterns],
            **chosen,
        },
        "imported": {
            "dataset": dataset, "digest": _digest(out, found.meshes), "given": provenance.given,
            "computed": provenance.computed, "left_out": provenance.left_out, "assumed": provenance.assumed,
        },
    }  # fmt: skip


def _digest(out: Path, meshes: TrackedMeshes) -> str:
    there = [name for name in (*TABLES, *(f"meshes/{path}" for path in meshes.elsewhere)) if (out / name).is_file()]
    return digest_bytes("\n".join(f"{digest_file(out / name)} {name}" for name in there).encode())


def write_mesh(path: Path, mesh: Mesh) -> None:
    """Write vertices, in their order, and triangles as a glTF binary or a .ply."""
    import trimesh  # A third of a second to import; only this function needs it.

    plain = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False, validate=False)
    with written_whole(path) as temporary:
        temporary.write_bytes(plain.export(file_type=path.suffix[1:]))
