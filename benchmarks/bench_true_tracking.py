"""Distance of tracked vertices from the truth of a synthetic capture: what stays the same, and what changes.

    python -m benchmarks.bench_true_tracking --results results/subjectA --change hinges={} --change image_rounds=15

prints a line of JSON for the subject's own tracking, and one for each `--change`, which tracks anew with the subject's
settings but for these. `always_p95_mm` is the part of a vertex's error that is the same in all frames, seen from the
surface: a texture that is learned on the mesh goes along with it, and no image can tell it. `changing_*` is the rest,
root mean squares in millimetres along the normal and along the surface, and the distance that 95 % stay within: it
blurs what is learned.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path

import numpy as np
import yaml
from jaxtyping import Float64, Int64

from pipeline.base.files import read_arrays
from pipeline.base.yaml_files import read_yaml
from pipeline.config.loading import load_project
from pipeline.config.track_mesh import TrackMesh
from pipeline.geometry.cameras import read_cameras
from pipeline.geometry.mesh import unit_or, vertex_normals, weld_vertices
from pipeline.geometry.texels import read_atlas
from pipeline.metrics.output_errors import align_rigs
from pipeline.stages import track_mesh


def true_vertices(results: Path, capture: Path, frames: Int64[np.ndarray, " frames"]) -> Float64[np.ndarray, "f v 3"]:
    """True vertices of some frames in the frame of the calibration that was found, metres."""
    true = read_arrays(capture / "truth/tracking.safetensors")
    row = {int(frame): number for number, frame in enumerate(true["frames"])}
    motion = align_rigs(
        read_cameras(results / "calibration/cameras.json"), read_cameras(capture / "truth/cameras.json")
    )
    vertices = true["vertices"][[row[int(frame)] for frame in frames]].astype(np.float64)
    return (vertices - motion.t) @ motion.R


def on_the_surface(
    errors: Float64[np.ndarray, "f v 3"], vertices: Float64[np.ndarray, "f v 3"], faces: Int64[np.ndarray, "n 3"]
) -> Float64[np.ndarray, "f v 3"]:
    """Errors along each vertex's normal, along an edge of one of its faces, and across both."""
    weld, other = weld_vertices(vertices[0], faces), np.zeros(vertices.shape[1], np.int64)
    other[faces] = np.roll(faces, -1, axis=1)
    turned = np.empty_like(errors)
    for error, mesh, out in zip(errors, vertices, turned, strict=True):
        normal = unit_or(vertex_normals(mesh, faces, weld), 0.0)
        along = mesh[other] - mesh
        along = unit_or(along - (along * normal).sum(1, keepdims=True) * normal, 0.0)
        axes = np.stack([normal, along, np.cross(normal, along)], 1)
        out[:] = np.einsum("vad,vd->va", axes, error)
    return turned


def summary(results: Path, capture: Path, tracking: Path) -> dict[str, float]:
    """Errors of one tracking, millimetres."""
    found, faces = read_arrays(tracking / "0000.safetensors"), read_atlas(results / "atlas.safetensors").faces
    true = true_vertices(results, capture, found["frames"])
    error = 1e3 * on_the_surface(found["vertices"].astype(np.float64) - true, true, faces)
    always = error.mean(0)
    changing, size = error - always, np.linalg.norm(error, axis=-1)
    return {
        "p95_mm": np.percentile(size, 95),
        "always_p95_mm": np.percentile(np.linalg.norm(always, axis=-1), 95),
        "changing_normal_mm": np.sqrt((changing[..., 0] ** 2).mean()),
        "changing_along_mm": np.sqrt((changing[..., 1:] ** 2).sum(-1).mean()),
        "changing_p95_mm": np.percentile(np.linalg.norm(changing, axis=-1), 95),
    }


def track(results: Path, capture: Path, out: Path, settings: TrackMesh) -> None:
    """Track the first chunk anew."""
    track_mesh.run(
        capture=capture, index=results / "index", cameras=results / "calibration/cameras.json", chunk=0, out=out,
        patterns=results / "patterns.parquet", lights=results / "calibration/lights.parquet", settings=settings,
    )  # fmt: skip


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--results", type=Path, required=True, help="results/SUBJECT of a finished run")
    parser.add_argument("--capture", type=Path, help="captures/SUBJECT")
    parser.add_argument("--change", nargs="+", action="append", default=[], help="NAME=YAML of track_mesh")
    args = parser.parse_args()
    capture = args.capture or args.results.parents[1] / "captures" / args.results.name

    def said(what: str, tracking: Path, seconds: float | None) -> None:
        errors = {name: round(float(value), 3) for name, value in summary(args.results, capture, tracking).items()}
        print(json.dumps({"subject": args.results.name, "settings": what, "seconds": seconds, **errors}), flush=True)

    said("of the results", args.results / "tracking", None)
    project = load_project(read_yaml(Path("config/config.yaml")), {}, Path("config/subjects"))
    own = project.subject(args.results.name).track_mesh.model_dump()
    for change in args.change:
        words = (each.split("=", 1) for each in change)
        settings = TrackMesh.model_validate(own | {name: yaml.safe_load(value) for name, value in words})
        with tempfile.TemporaryDirectory() as folder:
            started = time.monotonic()
            track(args.results, capture, Path(folder), settings)
            said(" ".join(change), Path(folder), round(time.monotonic() - started, 1))


if __name__ == "__main__":
    main()
