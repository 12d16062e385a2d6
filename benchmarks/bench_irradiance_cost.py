"""What an irradiance map costs and how wrong it is: 1 ray per texel to all, 8 to 1,024 lights (RFGCA's Table A.1).

    python -m benchmarks.bench_irradiance_cost --results results/subjectA --page docs/irradiance.md

Lights are spread evenly over a dome of 2.4 m around the tracked mesh of a finished run, at the middle frame, in any
order, all lit and of one brightness. One thread; milliseconds are the processor's, medians over `--repeats`, ways in
turn. The error of a map is the root mean square of its cosine-weighted share against that of all rays. That of a
picture is PSNR against the same map, of a grey matte body under these lights, seen by the run's cameras. Prints a line
of JSON for each way, and writes them between the marks of the page.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

from benchmarks.irradiance_figure import draw_irradiance
from benchmarks.irradiance_poses import dome
from benchmarks.marked_page import write_between
from pipeline.base.color import srgb_from_linear
from pipeline.base.files import read_arrays
from pipeline.config.trace_irradiance import TraceIrradiance
from pipeline.geometry.cameras import Camera, read_cameras
from pipeline.geometry.depth_maps import draw_depth
from pipeline.geometry.texel_surface import texel_surface
from pipeline.geometry.texels import Atlas, read_atlas
from pipeline.lighting.frame_irradiance import FrameTracer, StageLights
from pipeline.lighting.irradiance import IrradianceMap
from pipeline.lighting.light_scene import Lights, light_scene
from pipeline.lighting.visibility import Occluders
from pipeline.metrics.images import psnr_db

LIGHTS = (8, 24, 96, 384, 1024)

WAYS = {
    "1 ray, alone": {"samples": "1", "share_rays": False, "sampling": "uniform", "spread": "random"},
    **{f"{count} shared": {"samples": str(count)} for count in (1, 2, 4, 8, 16)},
    "all": {"samples": "full"},
}
"""The first is A.3 to the letter; of the others each texel also uses what its neighbours' rays found."""

GREY = 0.5
"""Albedo of the body."""


@dataclass(frozen=True)
class Body:
    """A tracked mesh, and where each camera sees which texel: -1 beside the body."""

    atlas: Atlas
    vertices: np.ndarray
    seen: list[np.ndarray]

    def falling(self, lights: Lights) -> np.ndarray:
        """Cosine-weighted light that falls on each texel if nothing is in its way, a white body's brightest 1."""
        points, normals, face_normals = texel_surface(self.atlas, self.vertices)
        occluders = Occluders(self.vertices, self.atlas.faces)
        scene = light_scene(occluders, points, face_normals, lights, normals)
        if scene is None:
            raise ValueError("expected a lit light, found none")
        with np.errstate(divide="ignore"):
            light = 1 / scene.per_arriving()[1]
        light[~np.isfinite(light)] = 0.0
        return light / light.max()

    def pictures(self, falling: np.ndarray, share: np.ndarray) -> list[np.ndarray]:
        """What the cameras see of it, sRGB, a grey value per pixel."""
        shade = srgb_from_linear((GREY * falling * share).clip(0, 1))
        return [np.where(seen >= 0, shade[seen], 0.0) for seen in self.seen]


def seen_texels(camera: Camera, vertices: np.ndarray, atlas: Atlas) -> np.ndarray:
    """Number of the texel nearest to the surface that each pixel's centre sees; -1 where it sees none."""
    depth = draw_depth(camera, vertices, atlas.faces.astype(np.int64))
    rows, columns = np.nonzero(np.isfinite(depth))
    way = camera.ray_directions(np.stack([columns, rows], 1) + 0.5)
    ahead = way @ camera.R[2]
    points = camera.center + way * (depth[rows, columns] / ahead)[:, None]
    seen = np.full(depth.shape, -1, np.int64)
    seen[rows, columns] = KDTree(texel_surface(atlas, vertices)[0]).query(points)[1]
    return seen


def measured(body: Body, lights: Lights, repeats: int) -> Iterator[dict[str, object]]:
    """A row for each way."""
    stage, middle = lights.places, dict.fromkeys([0], lights.luminances)
    tracers = {
        name: FrameTracer(body.atlas, StageLights(stage, middle), TraceIrradiance(visibility="traced", **way))
        for name, way in WAYS.items()
    }
    seconds: dict[str, list[float]] = {name: [] for name in WAYS}
    maps: dict[str, list[IrradianceMap]] = {name: [] for name in WAYS}
    for turn in range(repeats + 1):
        for name, tracer in tracers.items():
            started = time.process_time()
            found = tracer.trace(0, body.vertices, np.random.default_rng(turn))
            if turn:  # the first compiles
                seconds[name].append(time.process_time() - started)
                maps[name].append(found)
    falling, exact = body.falling(lights), maps["all"][0].cosine_visibility
    truth = body.pictures(falling, exact)
    for name, drawn in maps.items():
        shares = [found.cosine_visibility for found in drawn]
        pairs = [pair for share in shares for pair in zip(body.pictures(falling, share), truth, body.seen, strict=True)]
        scores = [psnr_db(a[..., None], b[..., None], seen >= 0) for a, b, seen in pairs]
        yield {
            "lights": len(stage), "way": name, "ms": 1e3 * statistics.median(seconds[name]), "rays": drawn[0].rays,
            "map_rms": float(np.sqrt(np.mean([(share - exact) ** 2 for share in shares]))),
            "picture_db": float(np.mean(scores)),
        }  # fmt: skip


def page_lines(rows: list[dict[str, object]], texels: int, pixels: int) -> list[str]:
    """The table of the page: a column for each number of lights."""
    counts = sorted({int(row["lights"]) for row in rows})
    cells = {(row["lights"], row["way"]): row for row in rows}
    lines = [
        f"{texels:,} texels; milliseconds of one processor for a map · error of the map · PSNR of pictures "
        f"({pixels:,} pixels of the body). **Bold**: the map takes as long as that of all rays, or longer.",
        "",
        "| rays per texel | " + " | ".join(f"{count:,} lights" for count in counts) + " |",
        "|---" * (1 + len(counts)) + "|",
    ]
    for way in WAYS:
        shown = []
        for count in counts:
            row, whole = cells[count, way], cells[count, "all"]
            text = f"{row['ms']:.0f} ms"
            if row["map_rms"] > 0:
                text += f" · {row['map_rms']:.3f} · {row['picture_db']:.1f} dB"
            slow = way != "all" and row["ms"] >= whole["ms"]
            shown.append(f"**{text}**" if slow else text)
        lines.append(f"| {way} | " + " | ".join(shown) + " |")
    return lines


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--results", type=Path, required=True, help="results/SUBJECT of a finished run")
    parser.add_argument("--repeats", type=int, default=5, help="timed maps of each way")
    parser.add_argument("--page", type=Path, help="page with the marks irradiance: begin and end")
    args = parser.parse_args()
    atlas, tracking = (
        read_atlas(args.results / "atlas.safetensors"),
        read_arrays(args.results / "tracking/0000.safetensors"),
    )
    vertices = tracking["vertices"][len(tracking["frames"]) // 2].astype(np.float64)
    cameras = read_cameras(args.results / "calibration/cameras.json").values()
    body = Body(atlas, vertices, [seen_texels(camera, vertices, atlas) for camera in cameras])
    center, rows = vertices.mean(0), []
    for count in LIGHTS:
        lights = dome(count)
        # A lamp's place in a list says nothing: in the order of the spiral, neighbours would be drawn in step.
        lights = Lights(np.random.default_rng(0).permutation(lights.places), lights.luminances)
        for row in measured(body, Lights(lights.places + center, lights.luminances), args.repeats):
            rows.append(row)
            print(json.dumps({k: float(f"{v:.4g}") if isinstance(v, float) else v for k, v in row.items()}), flush=True)
    if args.page:
        pixels = sum(int((seen >= 0).sum()) for seen in body.seen)
        write_between(args.page, "irradiance", page_lines(rows, len(atlas.texel), pixels))
        draw_irradiance(args.page.parent / "pictures/irradiance_cost.png", rows)


if __name__ == "__main__":
    main()
